// Floor: a grid whose squares can be counted, shadows on it, and the way each individual goes.
const edge = new Float64Array(8);
const ground = { canvas: document.createElement('canvas'), key: [] };

// Grid and ways stay as they are while a clip plays: they are drawn when the view changes, and copied.
function drawGround(ctx, width, height, look) {
  const { canvas } = ctx, key = [kept.size, kept.colours, kept.hidden.size, state.placed, state.tint, state.yaw, state.pitch, state.zoom, state.panX, state.panY, canvas.width, canvas.height];
  if (key.some((part, k) => part !== ground.key[k])) {
    ground.key = key;
    if (ground.canvas.width !== canvas.width || ground.canvas.height !== canvas.height) Object.assign(ground.canvas, { width: canvas.width, height: canvas.height });
    const under = ground.canvas.getContext('2d');
    under.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
    under.clearRect(0, 0, width, height);
    drawFloor(under, look, kept.size, kept.colours);
    if (kept.trails && state.placed) clipNow().individuals.forEach((name, who) => kept.hidden.has(name) || drawTrail(under, look, who));
  }
  ctx.globalCompositeOperation = 'copy';
  ctx.drawImage(ground.canvas, 0, 0, width, height);
  ctx.globalCompositeOperation = 'source-over';
}

// A round step near a tenth of the scene.
function gridStep(radius) {
  const raw = radius / 4.5, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((k) => k * power >= raw * 0.99);
}

// Discs of grid lines on top of each other, so that it fades outwards. (Many lines in one stroke are slower to fill.)
function drawFloor(ctx, look, size, colours) {
  const step = gridStep(size.radius), reach = Math.ceil((1.5 * Math.max(size.half[0], size.half[2], size.tall)) / step);
  const x0 = Math.round(size.centre[0] / step) * step, z0 = Math.round(size.centre[2] / step) * step;
  ctx.strokeStyle = colours.floor;
  ctx.lineWidth = 1;
  ctx.globalAlpha = 0.4;
  for (const share of [1, 0.76, 0.52]) {
    for (let n = -reach; n <= reach; n++) {
      const chord = Math.sqrt((share * reach) ** 2 - n * n) * step;
      if (!(chord > 0)) continue;
      for (const across of [true, false]) {
        look(x0 + (across ? -chord : n * step), size.floor, z0 + (across ? n * step : -chord), edge);
        look(x0 + (across ? chord : n * step), size.floor, z0 + (across ? n * step : chord), edge, 4);
        line(ctx, edge[0], edge[1], edge[4], edge[5]);
      }
    }
  }
  ctx.globalAlpha = 1;
}

function drawShadow(ctx, look, figure, size, colours) {
  projectRow(look, figure.world, figure.ground, size.floor);
  const flat = figure.ground;
  ctx.strokeStyle = colours.ink;
  ctx.globalAlpha = 0.1;
  ctx.lineWidth = 6;
  ctx.beginPath();
  for (let n = 0; n < B; n++) {
    const [a, b] = meta.bones[n];
    // Thin parts (fingers, a face) cost time and cast a blot.
    if (kept.boneWidths[n] < 2.2 || Number.isNaN(flat[4 * a] + flat[4 * b])) continue;
    ctx.moveTo(flat[4 * a], flat[4 * a + 1]); ctx.lineTo(flat[4 * b], flat[4 * b + 1]);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

// Where the roots of every individual go during a clip: x and z, at most 150 points each.
function trailsOf(A, clip) {
  const every = Math.max(1, Math.ceil(clip.moments.length / 150)), trails = clip.individuals.map(() => []);
  clip.moments.forEach((rows, m) => {
    if (m % every === 0) for (const row of rows) trails[value(A.individual, row)].push(value(A.levelPlace, 3 * row), value(A.levelPlace, 3 * row + 2));
  });
  return trails;
}

function drawTrail(ctx, look, who) {
  const trail = kept.trails[who];
  ctx.strokeStyle = state.tint ? kept.colours.hues[SIDES.length + (who % PEOPLE)][2] : kept.colours.soft;
  ctx.globalAlpha = 0.4;
  ctx.lineWidth = 1.2;
  ctx.beginPath();
  for (let k = 0; k < trail.length; k += 2) {
    look(trail[k], kept.size.floor, trail[k + 1], edge);
    ctx.lineTo(edge[0], edge[1]);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}
