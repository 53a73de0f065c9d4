// The 3D view: figures far to near, hollow joints and dashed bones where nothing was seen, uncertainty, truth.
const BINS = 160;
const sorted = { starts: new Int32Array(BINS + 1), bins: new Int16Array(0), order: new Int32Array(0), count: 0 };

// What is drawn of one figure is numbered: its bones, then the bones of its truth, then its joints.
const EACH = 2 * B + J;

function depthOf(figure, k) {
  if (k >= 2 * B) return figure.front[k - 2 * B];
  if (k >= B && !figure.hasTruth) return NaN;
  const points = k < B ? figure.points : figure.truth, bone = meta.bones[k < B ? k : k - B];
  return (points[4 * bone[0] + 2] + points[4 * bone[1] + 2]) / 2;
}

// Joints lie in front of the bones that they join.
function findFronts(figure) {
  const { front, points } = figure;
  for (let j = 0; j < J; j++) front[j] = points[4 * j + 2];
  for (let n = 0; n < B; n++) {
    const depth = depthOf(figure, n), [a, b] = meta.bones[n];
    if (depth < front[a]) front[a] = depth;
    if (depth < front[b]) front[b] = depth;
  }
  for (let j = 0; j < J; j++) front[j] -= 0.02;
}

// Orders everything far to near by counting, so that figures hide one another rightly.
function sortByDepth(figures) {
  const total = figures.length * EACH, { starts } = sorted;
  if (sorted.order.length < total) { sorted.order = new Int32Array(total); sorted.bins = new Int16Array(total); }
  starts.fill(0);
  for (const figure of figures) findFronts(figure);
  for (let id = 0; id < total; id++) {
    const depth = depthOf(figures[(id / EACH) | 0], id % EACH);
    const bin = Number.isNaN(depth) ? -1 : Math.max(0, Math.min(BINS - 1, Math.round(((1 - depth) / 2.1) * (BINS - 1))));
    sorted.bins[id] = bin;
    if (bin >= 0) starts[bin + 1]++;
  }
  for (let bin = 0; bin < BINS; bin++) starts[bin + 1] += starts[bin];
  sorted.count = starts[BINS];
  for (let id = 0; id < total; id++) if (sorted.bins[id] >= 0) sorted.order[starts[sorted.bins[id]]++] = id;
}

function line(ctx, x0, y0, x1, y1) { ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke(); }

function disc(ctx, x, y, radius) { ctx.beginPath(); ctx.arc(x, y, radius, 0, 7); ctx.fill(); }

function drawBone(ctx, figure, n, colours) {
  const P = figure.points, [a, b] = meta.bones[n], depth = (P[4 * a + 2] + P[4 * b + 2]) / 2;
  const width = kept.boneWidths[n] * (1 - 0.3 * depth) * P[4 * a + 3], dashed = filledAt(figure, a) || filledAt(figure, b);
  // A rim parts a bone from what it hides; on thin bones it would not be seen.
  if (!dashed && width > 2.4) {
    ctx.strokeStyle = colours.paper; ctx.lineWidth = width + Math.min(3, 0.6 * width);
    line(ctx, P[4 * a], P[4 * a + 1], P[4 * b], P[4 * b + 1]);
  }
  ctx.strokeStyle = shade(rampOf(figure, HUES.bones[n]), depth);
  ctx.lineWidth = dashed ? Math.max(1, width * 0.5) : width;
  if (dashed) ctx.setLineDash(DASH);
  line(ctx, P[4 * a], P[4 * a + 1], P[4 * b], P[4 * b + 1]);
  if (dashed) ctx.setLineDash(SOLID);
}

function drawTruthBone(ctx, figure, n, colours) {
  const P = figure.truth, [a, b] = meta.bones[n];
  ctx.strokeStyle = shade(colours.truth, (P[4 * a + 2] + P[4 * b + 2]) / 2);
  ctx.lineWidth = 1.5;
  line(ctx, P[4 * a], P[4 * a + 1], P[4 * b], P[4 * b + 1]);
}

function drawJoint(ctx, figure, j, colours) {
  const P = figure.points, x = P[4 * j], y = P[4 * j + 1], filled = filledAt(figure, j);
  const radius = kept.jointRadii[j] * (1 - 0.18 * P[4 * j + 2]) * P[4 * j + 3];
  if (!filled && radius < 1.6 && kept.boned[j]) return;
  const tone = shade(rampOf(figure, HUES.joints[j]), P[4 * j + 2]);
  ctx.fillStyle = filled ? tone : colours.paper;
  disc(ctx, x, y, radius + 0.8);
  ctx.fillStyle = filled ? colours.paper : tone;
  disc(ctx, x, y, filled ? Math.max(radius - 0.6, 0.8) : radius);
}

// A joint that was filled in has a ball as large as its expected error; the depth of one that was seen has a bar, on demand.
function drawUncertainty(ctx, look, figure, all, colours) {
  for (let j = 0; j < J; j++) {
    const radius = filledAt(figure, j) ? uncertaintyOf(figure, j) * look.scale * figure.points[4 * j + 3] : NaN;
    if (!(radius > 0)) continue;
    ctx.globalAlpha = 0.16;
    ctx.fillStyle = rampOf(figure, HUES.joints[j])[2];
    disc(ctx, figure.points[4 * j], figure.points[4 * j + 1], radius);
  }
  if (all) drawBars(ctx, look, figure, colours);
  ctx.globalAlpha = 1;
}

function drawBars(ctx, look, figure, colours) {
  const [dx, dy, dz] = figure.away, W = figure.world;
  ctx.lineWidth = 1.5;
  ctx.globalAlpha = 0.5;
  for (let hue = 0; hue < colours.hues.length; hue++) {
    ctx.strokeStyle = rampOf(figure, hue)[3];
    ctx.beginPath();
    for (let j = 0; j < J; j++) {
      const s = uncertaintyOf(figure, j), k = 3 * j;
      if (HUES.joints[j] !== hue || !(s > 0) || Number.isNaN(W[k]) || filledAt(figure, j)) continue;
      look(W[k] - s * dx, W[k + 1] - s * dy, W[k + 2] - s * dz, edge);
      look(W[k] + s * dx, W[k + 1] + s * dy, W[k + 2] + s * dz, edge, 4);
      drawBar(ctx, edge[0], edge[1], edge[4], edge[5]);
    }
    ctx.stroke();
  }
}

// A line with a tick across each of its ends.
function drawBar(ctx, x0, y0, x1, y1) {
  const length = Math.hypot(x1 - x0, y1 - y0) || 1, tx = (3.5 * (y1 - y0)) / length, ty = (-3.5 * (x1 - x0)) / length;
  ctx.moveTo(x0, y0); ctx.lineTo(x1, y1);
  ctx.moveTo(x0 - tx, y0 - ty); ctx.lineTo(x0 + tx, y0 + ty);
  ctx.moveTo(x1 - tx, y1 - ty); ctx.lineTo(x1 + tx, y1 + ty);
}

const DASH = [5, 4], SOLID = [];

function draw3d(ctx, width, height, look) {
  const { figures, size, colours } = kept;
  if (floored()) drawGround(ctx, width, height, look);
  else ctx.clearRect(0, 0, width, height);
  ctx.lineCap = 'butt'; ctx.lineJoin = 'round';
  thickness(size.lengths, look.scale, 5.5, kept.boneWidths, kept.jointRadii);
  if (floored()) for (const figure of figures) drawShadow(ctx, look, figure, size, colours);
  if (kept.arrays.uncertainty) for (const figure of figures) drawUncertainty(ctx, look, figure, state.uncertainty, colours);
  sortByDepth(figures);
  for (let n = 0; n < sorted.count; n++) {
    const figure = figures[(sorted.order[n] / EACH) | 0], k = sorted.order[n] % EACH;
    if (k < B) drawBone(ctx, figure, k, colours);
    else if (k < 2 * B) drawTruthBone(ctx, figure, k - B, colours);
    else drawJoint(ctx, figure, k - 2 * B, colours);
  }
  drawAxes(ctx, state, height, colours);
  if (state.names) for (const figure of figures) drawNames(ctx, figure.points, width, colours);
  drawTitles(ctx, figures, 'points', 4, 18, colours);
}
