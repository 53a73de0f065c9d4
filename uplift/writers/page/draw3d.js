// The 3D view: floor, shadows, bones far to near, joints, truth, uncertainty, names, axes.
const SIDES = ['middle', 'left', 'right'];
const LEVELS = 12;
const screen = new Float64Array(4);

function palette() {
  const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue('--' + name).trim();
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  const paper = rgb(read('paper'));
  const ramp = (name) => Array.from({ length: LEVELS }, (_, k) => {
    const mix = 0.6 * (k / (LEVELS - 1)) ** 1.4;
    return `rgb(${rgb(read(name)).map((c, a) => Math.round(c + (paper[a] - c) * mix)).join()})`;
  });
  return { paper: read('paper'), ink: read('ink'), soft: read('soft'), faint: read('faint'), floor: read('floor'),
    truth: ramp('truth'), sides: SIDES.map(ramp) };
}

function shade(ramp, depth) { return ramp[Math.min(LEVELS - 1, Math.max(0, Math.round(((depth + 1) / 2) * (LEVELS - 1))))]; }

function line(ctx, x0, y0, x1, y1) { ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke(); }

// A round step near a tenth of the scene, so that squares can be counted.
function gridStep(radius) {
  const raw = radius / 4.5, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((k) => k * power >= raw * 0.99);
}

function drawFloor(ctx, look, size, colours) {
  const step = gridStep(size.radius), reach = Math.ceil((1.5 * Math.max(size.half[0], size.half[2], size.tall)) / step);
  const x0 = Math.round(size.centre[0] / step), z0 = Math.round(size.centre[2] / step);
  const a = new Float64Array(4), b = new Float64Array(4);
  ctx.strokeStyle = colours.floor;
  ctx.lineWidth = 1;
  for (let n = -reach; n <= reach; n++) {
    for (let k = -reach; k < reach; k++) {
      const fade = 1 - Math.hypot(n, k + 0.5) / reach;
      if (fade <= 0) continue;
      ctx.globalAlpha = Math.min(1, fade * 1.3);
      look((x0 + n) * step, 0, (z0 + k) * step, a); look((x0 + n) * step, 0, (z0 + k + 1) * step, b);
      line(ctx, a[0], a[1], b[0], b[1]);
      look((x0 + k) * step, 0, (z0 + n) * step, a); look((x0 + k + 1) * step, 0, (z0 + n) * step, b);
      line(ctx, a[0], a[1], b[0], b[1]);
    }
  }
  ctx.globalAlpha = 1;
}

// Projects a placed row: joints x (screen x, y, depth, magnification).
function projectRow(look, world, y = null) {
  const out = new Float64Array(4 * J);
  for (let j = 0; j < J; j++) {
    look(world[3 * j], y === null ? world[3 * j + 1] : y, world[3 * j + 2], screen);
    out.set(screen, 4 * j);
  }
  return out;
}

function drawShadow(ctx, look, figure, colours) {
  const flat = projectRow(look, figure.world, 0);
  ctx.strokeStyle = colours.ink;
  ctx.globalAlpha = 0.09;
  ctx.lineWidth = 6;
  ctx.beginPath();
  for (const [a, b] of meta.bones) {
    if (Number.isNaN(flat[4 * a] + flat[4 * b])) continue;
    ctx.moveTo(flat[4 * a], flat[4 * a + 1]); ctx.lineTo(flat[4 * b], flat[4 * b + 1]);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

// Everything with a depth, so that figures hide one another rightly.
function strokes(figures, thick) {
  const list = [];
  for (const figure of figures) {
    meta.bones.forEach(([a, b], n) => {
      for (const [points, truth] of [[figure.truth, true], [figure.points, false]]) {
        if (!points || Number.isNaN(points[4 * a] + points[4 * b])) continue;
        const dashed = !truth && (figure.missing[a] || figure.missing[b]);
        list.push({ points, a, b, truth, dashed, side: meta.boneSides[n], depth: (points[4 * a + 2] + points[4 * b + 2]) / 2, thick });
      }
    });
    for (let j = 0; j < J; j++) {
      if (!Number.isNaN(figure.points[4 * j])) list.push({ points: figure.points, a: j, b: -1, dashed: figure.missing[j], side: meta.jointSides[j], depth: figure.points[4 * j + 2] - 0.15, thick });
    }
  }
  return list.sort((p, q) => q.depth - p.depth);
}

function drawStroke(ctx, item, colours) {
  const { points, a, b } = item, x = points[4 * a], y = points[4 * a + 1];
  const tone = shade(item.truth ? colours.truth : colours.sides[item.side], item.depth);
  if (b < 0) {
    const radius = item.thick * (0.78 - 0.14 * item.depth) * points[4 * a + 3];
    ctx.beginPath(); ctx.arc(x, y, radius, 0, 7);
    ctx.fillStyle = item.dashed ? colours.paper : tone;
    ctx.fill();
    ctx.strokeStyle = item.dashed ? tone : colours.paper;
    ctx.lineWidth = item.dashed ? 1.5 : 1;
    ctx.stroke();
    return;
  }
  const x1 = points[4 * b], y1 = points[4 * b + 1], width = item.truth ? 1.5 : item.thick * (1 - 0.32 * item.depth) * points[4 * a + 3];
  if (!item.truth && !item.dashed) {
    ctx.lineCap = 'butt'; ctx.strokeStyle = colours.paper; ctx.lineWidth = width + 3; line(ctx, x, y, x1, y1);
    ctx.lineCap = 'round';
  }
  ctx.strokeStyle = tone;
  ctx.lineWidth = item.dashed ? width * 0.6 : width;
  if (item.dashed) ctx.setLineDash([5, 5]);
  line(ctx, x, y, x1, y1);
  ctx.setLineDash([]);
}

function drawSpread(ctx, look, figure, colours) {
  const end = new Float64Array(4);
  ctx.lineWidth = 1.5;
  for (let j = 0; j < J; j++) {
    const [x, y, z] = figure.world.subarray(3 * j, 3 * j + 3), s = figure.spread[j];
    if (!(s > 0) || Number.isNaN(x)) continue;
    const [dx, dy, dz] = figure.away;
    look(x - s * dx, y - s * dy, z - s * dz, screen); look(x + s * dx, y + s * dy, z + s * dz, end);
    ctx.strokeStyle = shade(colours.sides[meta.jointSides[j]], figure.points[4 * j + 2]);
    ctx.globalAlpha = 0.45;
    line(ctx, screen[0], screen[1], end[0], end[1]);
  }
  ctx.globalAlpha = 1;
}

function drawAxes(ctx, view, height, colours) {
  const axes = [['x', 1, 0, 0], ['y', 0, 1, 0], ['z', 0, 0, 1]], cx = 34, cy = height - 34;
  ctx.font = '11px ui-sans-serif, system-ui, sans-serif';
  ctx.textAlign = 'center'; ctx.textBaseline = 'middle';
  ctx.strokeStyle = ctx.fillStyle = colours.soft;
  ctx.lineWidth = 1.2;
  for (const [name, x, y, z] of axes) {
    const right = Math.cos(view.yaw) * x + Math.sin(view.yaw) * z, away = Math.cos(view.yaw) * z - Math.sin(view.yaw) * x;
    const down = Math.cos(view.pitch) * y - Math.sin(view.pitch) * away;
    line(ctx, cx, cy, cx + 18 * right, cy + 18 * down);
    if (Math.hypot(right, down) > 0.25) ctx.fillText(name, cx + 26 * right, cy + 26 * down);
  }
}

function drawLabel(ctx, text, x, y, colours, align = 'center') {
  ctx.font = '12px ui-sans-serif, system-ui, sans-serif';
  ctx.textAlign = align; ctx.textBaseline = 'middle';
  ctx.lineWidth = 3; ctx.strokeStyle = colours.paper; ctx.fillStyle = colours.soft;
  ctx.strokeText(text, x, y); ctx.fillText(text, x, y);
}

// Names near to far; one that would cover another is left out.
function drawNames(ctx, points, width, colours) {
  const taken = [], order = meta.joints.map((_, j) => j).filter((j) => !Number.isNaN(points[4 * j]));
  for (const j of order.sort((a, b) => points[4 * a + 2] - points[4 * b + 2])) {
    const wide = ctx.measureText(meta.joints[j]).width, y = points[4 * j + 1];
    const x = Math.min(points[4 * j] + 9, width - wide - 6);
    if (taken.some((box) => Math.abs(y - box.y) < 13 && x < box.x + box.wide && box.x < x + wide)) continue;
    taken.push({ x, y, wide });
    drawLabel(ctx, meta.joints[j], x, y, colours, 'left');
  }
}

function draw3d(ctx, width, height, state, figures, size, look, colours) {
  const thick = Math.max(1.4, Math.min(5.5, 5.5 * Math.sqrt(20 / Math.max(J, 20))));
  const floor = state.level && meta.gravity;
  ctx.clearRect(0, 0, width, height);
  ctx.lineCap = ctx.lineJoin = 'round';
  if (floor) { drawFloor(ctx, look, size, colours); figures.forEach((figure) => drawShadow(ctx, look, figure, colours)); }
  if (state.spread) figures.forEach((figure) => figure.spread && drawSpread(ctx, look, figure, colours));
  for (const item of strokes(figures, thick)) drawStroke(ctx, item, colours);
  drawAxes(ctx, state, height, colours);
  for (const figure of figures) {
    if (state.names) drawNames(ctx, figure.points, width, colours);
    const top = figure.points.reduce((best, y, k) => (k % 4 === 1 && y < best[0] ? [y, k - 1] : best), [Infinity, -1]);
    if (figure.name && top[1] >= 0) drawLabel(ctx, figure.name, figure.points[top[1]], top[0] - 18, colours);
  }
}
