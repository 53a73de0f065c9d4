// Labels: the axes of the data, names of joints and of individuals.
const AXES = [['x', 1, 0, 0], ['y', 0, 1, 0], ['z', 0, 0, 1]];
const FONT = 'px ui-sans-serif, system-ui, sans-serif';

function drawAxes(ctx, view, height, colours) {
  const cx = 34, cy = height - 34;
  ctx.font = 11 + FONT;
  ctx.textAlign = 'center'; ctx.textBaseline = 'middle';
  ctx.strokeStyle = ctx.fillStyle = colours.soft;
  ctx.lineWidth = 1.2;
  for (const [name, x, y, z] of AXES) {
    const right = Math.cos(view.yaw) * x + Math.sin(view.yaw) * z, away = Math.cos(view.yaw) * z - Math.sin(view.yaw) * x;
    const down = Math.cos(view.pitch) * y - Math.sin(view.pitch) * away;
    line(ctx, cx, cy, cx + 18 * right, cy + 18 * down);
    if (Math.hypot(right, down) > 0.25) ctx.fillText(name, cx + 26 * right, cy + 26 * down);
  }
}

function drawLabel(ctx, text, x, y, colours, align = 'center') {
  ctx.font = 12 + FONT;
  ctx.textAlign = align; ctx.textBaseline = 'middle';
  ctx.lineWidth = 3; ctx.strokeStyle = colours.paper; ctx.fillStyle = colours.soft;
  ctx.strokeText(text, x, y); ctx.fillText(text, x, y);
}

// The name of each individual over its highest joint, moved up where it would cover another.
const titles = { count: 0, x: new Float64Array(64), y: new Float64Array(64), wide: new Float64Array(64) };

function drawTitles(ctx, figures, field, stride, above, colours) {
  titles.count = 0;
  ctx.font = 12 + FONT;
  for (const figure of figures) {
    const top = topOf(figure[field], stride), n = titles.count;
    if (!figure.name || top < 0 || n >= titles.x.length) continue;
    const wide = (figure.wide ??= ctx.measureText(figure.name).width);
    titles.x[n] = figure[field][stride * top]; titles.y[n] = figure[field][stride * top + 1] - above; titles.wide[n] = wide;
    for (let other = 0; other < n; other++) {
      const apart = Math.abs(titles.x[other] - titles.x[n]) > (titles.wide[other] + wide) / 2 + 4;
      if (!apart && Math.abs(titles.y[other] - titles.y[n]) < 14) { titles.y[n] = titles.y[other] - 14; other = -1; }
    }
    titles.count++;
    drawLabel(ctx, figure.name, titles.x[n], titles.y[n], colours);
  }
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

// A ring round the joint under the pointer, in both views.
function drawHover(deep, flat) {
  const figure = kept.figures.find((one) => one.who === kept.hover.who), j = kept.hover.joint;
  if (!figure) return;
  write('tip', describe(figure, j));
  for (const [ctx, x, y] of [[deep, figure.points[4 * j], figure.points[4 * j + 1]], [flat, figure.flat[2 * j], figure.flat[2 * j + 1]]]) {
    if (Number.isNaN(x)) continue;
    ctx.strokeStyle = kept.colours.ink; ctx.lineWidth = 2;
    ctx.beginPath(); ctx.arc(x, y, 9, 0, 7); ctx.stroke();
  }
}
