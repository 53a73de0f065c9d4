// The 3D view: shapes lit, on a disc with their shadow that tells where their front is.
const FLOOR_STEPS = 72, SHADOW_SIDE = 96, SHADOW_REACH = 1.6, SHADOW_DARK = 0.55;
const MOST_DOUBT = 0.5; // no share of inside and outside has a larger standard deviation

// Draws one shape into the box (x, y, width, height) of a canvas, `fine` pixels a CSS pixel.
function drawShape(ctx, mesh, placing, { x, y, width, height, px, turn, lift, panX = 0, panY = 0, fine, colours, look: own = null, floor = true }) {
  const target = bufferOf(Math.max(1, Math.round(width * fine)), Math.max(1, Math.round(height * fine)));
  const look = { matrix: turned(placing.view, turn, lift), scale: placing.scale, x: 0, y: 0, distance: placing.scale * (6 * mesh.far), centre: mesh.centre,
    px: px * fine, cx: (width / 2 + panX) * fine, cy: (height / 2 + panY) * fine };
  const flat = { ...look, px, cx: x + width / 2 + panX, cy: y + height / 2 + panY }, above = floor && tiltOf(look.matrix) >= 0;
  if (above || tiltOf(look.matrix) >= 0) drawShadow(ctx, mesh, flat);
  if (above) drawFloor(ctx, mesh, flat);
  raster(target, mesh, look, true, own);
  stamp(ctx, target, colours, x, y, width, height, own?.colours);
  if (floor && !above) drawFloor(ctx, mesh, flat);
}

// What a lifted shape is painted with: its uncertainty, its photo, or nothing.
function lookOf(item, mesh) {
  const texture = kept.textures.get(item);
  if (state.doubt && mesh.doubt) {
    mesh.doubtful ??= { width: 256, row: new Float32Array(mesh.doubt.length), column: mesh.doubt.map((v) => Math.max(0, Math.min(255, (v / MOST_DOUBT) * 255))) };
    return { ...mesh.doubtful, colours: kept.colours.doubt };
  }
  if (!state.photo || !texture || !mesh.across) return null;
  mesh.pictured ??= { width: texture.width, row: mesh.down.map((v) => Math.min(texture.height - 1, v * texture.height)), column: mesh.across.map((v) => Math.min(texture.width - 1, v * texture.width)) };
  return { ...mesh.pictured, colours: texture.colours };
}

// The shadow on the floor under a shape, seen from above: what is low is dark and sharp, what is high faint and wide.
function shadowOf(mesh) {
  if (mesh.shadow) return mesh.shadow;
  const side = SHADOW_SIDE, reach = SHADOW_REACH * mesh.wide, dark = new Float32Array(side * side), { points, faces } = mesh, above = new Float32Array(points.length);
  for (let k = 0; k < points.length; k += 3) for (const [to, from] of [[0, 0], [1, 2]]) above[k + to] = side / 2 + ((points[k + from] - mesh.centre[from]) / reach) * (side / 2);
  for (const [share, most, wide, times] of [[0.45, 1, 3, 2], [0.5, 0.12, 1, 2]]) {
    const light = new Uint8Array(side * side), lowest = mesh.high[1] - most * (mesh.high[1] - mesh.low[1]) - 1e-6;
    if (screen.length < points.length) screen = new Float32Array(points.length);
    screen.set(above);
    for (let f = 0; f < faces.length; f += 3) {
      const [p, q, r] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      if (points[p + 1] > lowest && points[q + 1] > lowest && points[r + 1] > lowest) coverTriangle(light, side, side, p, q, r);
    }
    blurred(Float32Array.from(light), side, wide, times).forEach((v, k) => { dark[k] = Math.min(0.62, dark[k] + (share * v) / 255); });
  }
  const canvas = document.createElement('canvas');
  canvas.width = canvas.height = side;
  const to = canvas.getContext('2d'), image = to.createImageData(side, side);
  for (let k = 0; k < dark.length; k++) image.data[4 * k + 3] = 255 * dark[k] * SHADOW_DARK;
  to.putImageData(image, 0, 0);
  mesh.shadow = canvas;
  return canvas;
}

// Boxes of 2 `wide` + 1 cells, along both ways, `times` over.
function blurred(cells, side, wide, times) {
  for (let turn = 0; turn < 2 * times; turn++) {
    const found = new Float32Array(cells.length), [step, line] = turn % 2 ? [side, 1] : [1, side];
    for (let a = 0; a < side; a++) {
      let sum = 0;
      for (let b = -wide; b < side; b++) {
        if (b + wide < side) sum += cells[a * line + (b + wide) * step];
        if (b - wide - 1 >= 0) sum -= cells[a * line + (b - wide - 1) * step];
        if (b >= 0) found[a * line + b * step] = sum / (2 * wide + 1);
      }
    }
    cells = found;
  }
  return cells;
}

function drawShadow(ctx, mesh, look) {
  const reach = SHADOW_REACH * mesh.wide, [cx, , cz] = mesh.centre, y = mesh.high[1];
  const shadow = shadowOf(mesh);
  project(new Float32Array([cx, y, cz, cx + reach, y, cz, cx, y, cz + reach]), look, mesh.centre);
  const [ox, oy] = screen, half = SHADOW_SIDE / 2, [ax, ay, bx, by] = [screen[3] - ox, screen[4] - oy, screen[6] - ox, screen[7] - oy];
  ctx.save();
  ctx.transform(ax / half, ay / half, bx / half, by / half, ox, oy);
  ctx.drawImage(shadow, -half, -half);
  ctx.restore();
}

// A ring under the shape and a tip towards its front.
function drawFloor(ctx, mesh, look) {
  const reach = 1.12 * mesh.wide, [cx, , cz] = mesh.centre, points = new Float32Array(3 * (FLOOR_STEPS + 4));
  const put = (k, x, z) => { points[3 * k] = cx + x; points[3 * k + 1] = mesh.high[1]; points[3 * k + 2] = cz + z; };
  for (let k = 0; k < FLOOR_STEPS; k++) put(k, reach * Math.sin((2 * Math.PI * k) / FLOOR_STEPS), -reach * Math.cos((2 * Math.PI * k) / FLOOR_STEPS));
  [[-0.07, -1.03], [0.07, -1.03], [0, -1.16], [0, -1.3]].forEach(([a, b], k) => put(FLOOR_STEPS + k, reach * a, reach * b));
  project(points, look, mesh.centre);
  const at = (k) => [screen[3 * k], screen[3 * k + 1]], { colours } = kept;
  ctx.strokeStyle = colours.floor; ctx.lineWidth = 1.2;
  ctx.beginPath();
  for (let k = 0; k < FLOOR_STEPS; k++) ctx.lineTo(...at(k));
  ctx.closePath(); ctx.stroke();
  ctx.fillStyle = ctx.strokeStyle = colours.soft;
  ctx.beginPath();
  for (const k of [0, 1, 2]) ctx.lineTo(...at(FLOOR_STEPS + k));
  ctx.closePath(); ctx.fill();
  ctx.font = '11px ui-sans-serif, system-ui, sans-serif'; ctx.textAlign = 'center'; ctx.textBaseline = 'middle';
  ctx.fillText('front', ...at(FLOOR_STEPS + 3));
}

// Half of what has to fit: the lifted and the true shape are drawn at one scale.
function halfOf(one) {
  const sizes = [[meshOf(one.mesh), one.scale], [one.truth && state.truth ? meshOf(one.truth.mesh) : null, one.truth?.scale]].filter(([mesh]) => mesh);
  return { wide: Math.max(1e-6, ...sizes.map(([mesh, scale]) => scale * mesh.wide)), tall: Math.max(1e-6, ...sizes.map(([mesh, scale]) => scale * mesh.tall)) };
}

// Half of what one view of a shape takes, in units of the crop, without perspective.
function extentOf(mesh, placing, turn, lift) {
  project(mesh.points, { matrix: turned(placing.view, turn, lift), scale: placing.scale, x: 0, y: 0, distance: Infinity, px: 1, cx: 0, cy: 0 }, mesh.centre);
  let most = 1e-6;
  for (let k = 0; k < mesh.points.length; k += 3) most = Math.max(most, Math.abs(screen[k]), Math.abs(screen[k + 1]));
  return most;
}

function drawDeep(canvas, item, moving) {
  const { ctx, width, height, ratio } = fitCanvas(canvas), one = meta.items[item], both = Boolean(one.truth && state.truth);
  const beside = both && width > 1.1 * height, wide = beside ? width / 2 : width, high = both && !beside ? height / 2 : height;
  const half = halfOf(one), px = Math.min((0.41 * wide) / half.wide, (0.44 * high) / (half.tall + 0.62 * half.wide)) * state.zoom;
  const shared = { width: wide, height: high, px, turn: state.turn, lift: state.lift, panX: state.panX, panY: state.panY, fine: moving ? 1 : Math.max(ratio, 2) };
  const drawn = meshOf(one.mesh);
  if (drawn) drawShape(ctx, drawn, one, { ...shared, x: 0, y: 0, colours: kept.colours.clay, look: lookOf(item, drawn) });
  else tellNothing(ctx, one.about, wide, high);
  if (!both) return;
  drawShape(ctx, meshOf(one.truth.mesh), one.truth, { ...shared, x: beside ? wide : 0, y: beside ? 0 : high, colours: kept.colours.true });
  drawCaption(ctx, 'lifted', 12, 18);
  drawCaption(ctx, 'true', (beside ? wide : 0) + 12, (beside ? 0 : high) + 18);
}

function drawCaption(ctx, text, x, y) {
  ctx.font = '12px ui-sans-serif, system-ui, sans-serif'; ctx.textAlign = 'left'; ctx.textBaseline = 'middle';
  ctx.fillStyle = kept.colours.soft;
  ctx.fillText(text, x, y);
}

function tellNothing(ctx, text, width, height) {
  ctx.font = '13px ui-sans-serif, system-ui, sans-serif'; ctx.textAlign = 'center'; ctx.textBaseline = 'middle';
  ctx.fillStyle = kept.colours.soft;
  ctx.fillText('no surface', width / 2, height / 2 - 10);
  ctx.fillText(text, width / 2, height / 2 + 10, width - 16);
}
