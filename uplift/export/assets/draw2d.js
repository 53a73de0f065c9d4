// The 2D view: the keypoints as they came in, paler where they are less sure.
const TONES = 4;

// Bounds of a clip's keypoints in px, its own extent with a margin, never a tiny crop; and mean lengths of bones.
function measureFlat(A, clip) {
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  const K = A.keypoints, lengths = new Float64Array(B), counts = new Float64Array(B);
  for (const rows of clip.moments) {
    for (const row of rows) {
      for (let k = 2 * row * J; k < 2 * (row + 1) * J; k += 2) {
        if (K.codes[k] === ABSENT) continue;
        const x = value(K, k), y = value(K, k + 1);
        x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
      }
      meta.bones.forEach(([a, b], n) => {
        const p = 2 * (row * J + a), q = 2 * (row * J + b);
        if (K.codes[p] === ABSENT || K.codes[q] === ABSENT) return;
        lengths[n] += K.step * Math.hypot(K.codes[p] - K.codes[q], K.codes[p + 1] - K.codes[q + 1]); counts[n]++;
      });
    }
  }
  const mean = lengths.map((sum, n) => sum / (counts[n] || 1));
  if (x0 > x1) return { x: 0, y: 0, wide: 1, tall: 1, lengths: mean };
  const [W, H] = meta.imageSize || [0, 0], margin = Math.max(x1 - x0, y1 - y0, 1e-6) * 0.12;
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, wide: Math.max(x1 - x0 + 2 * margin, W / 4), tall: Math.max(y1 - y0 + 2 * margin, H / 4), lengths: mean };
}

function flatEye(bounds, width, height) {
  const scale = Math.min(width / bounds.wide, height / bounds.tall);
  return { scale, x: (x) => width / 2 + (x - bounds.x) * scale, y: (y) => height / 2 + (y - bounds.y) * scale };
}

// Fills out: joints x (screen x, y), NaN where nothing was seen.
function flatRow(A, row, see, out) {
  const K = A.keypoints;
  for (let j = 0; j < J; j++) {
    const k = 2 * (row * J + j), seen = K.codes[k] !== ABSENT;
    out[2 * j] = seen ? see.x(value(K, k)) : NaN;
    out[2 * j + 1] = seen ? see.y(value(K, k + 1)) : NaN;
  }
}

function drawImageFrame(ctx, see, colours) {
  if (!meta.imageSize) return;
  ctx.strokeStyle = colours.faint;
  ctx.lineWidth = 1;
  ctx.strokeRect(see.x(0), see.y(0), meta.imageSize[0] * see.scale, meta.imageSize[1] * see.scale);
}

// One of TONES strengths, so that little changes from stroke to stroke.
function tone(sure) { return 0.3 + (0.7 * Math.round(sure * TONES)) / TONES; }

function drawFlat(ctx, figure, rimmed) {
  const { flat } = figure, { flatWidths, flatRadii } = kept;
  if (rimmed) { // parts the lines from the picture behind them
    ctx.globalAlpha = 0.75; ctx.strokeStyle = kept.colours.paper;
    for (let n = 0; n < B; n++) {
      const [a, b] = meta.bones[n];
      ctx.lineWidth = flatWidths[n] + 2;
      if (!Number.isNaN(flat[2 * a] + flat[2 * b])) line(ctx, flat[2 * a], flat[2 * a + 1], flat[2 * b], flat[2 * b + 1]);
    }
  }
  for (let n = 0; n < B; n++) {
    const [a, b] = meta.bones[n];
    if (Number.isNaN(flat[2 * a] + flat[2 * b])) continue;
    ctx.lineWidth = flatWidths[n];
    ctx.strokeStyle = rampOf(figure, HUES.bones[n])[0];
    ctx.globalAlpha = 0.85 * tone(Math.min(sureOf(figure, a), sureOf(figure, b)));
    line(ctx, flat[2 * a], flat[2 * a + 1], flat[2 * b], flat[2 * b + 1]);
  }
  for (let j = 0; j < J; j++) {
    if (Number.isNaN(flat[2 * j]) || (flatRadii[j] < 1.4 && kept.boned[j])) continue;
    ctx.globalAlpha = tone(sureOf(figure, j));
    ctx.fillStyle = rampOf(figure, HUES.joints[j])[0];
    disc(ctx, flat[2 * j], flat[2 * j + 1], 1.4 * flatRadii[j]);
  }
  ctx.globalAlpha = 1;
}

function draw2d(ctx, width, height, see) {
  ctx.clearRect(0, 0, width, height);
  ctx.lineCap = 'butt';
  const rimmed = drawBehind(ctx, see);
  drawImageFrame(ctx, see, kept.colours);
  thickness(kept.bounds.lengths, see.scale, 3.5, kept.flatWidths, kept.flatRadii);
  for (const figure of kept.figures) drawFlat(ctx, figure, rimmed);
  drawTitles(ctx, kept.figures, 'flat', 2, 16, kept.colours);
}
