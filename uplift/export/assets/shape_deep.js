// The 3D view: shapes lit on a disc that tells where their front is.
const FLOOR_STEPS = 72;

// Draws one shape into the box (x, y, width, height) of a canvas, `fine` pixels a CSS pixel.
function drawShape(ctx, mesh, placing, { x, y, width, height, px, turn, lift, panX = 0, panY = 0, fine, colours, floor = true }) {
  const target = bufferOf(Math.max(1, Math.round(width * fine)), Math.max(1, Math.round(height * fine)));
  const look = { matrix: turned(placing.view, turn, lift), scale: placing.scale, x: 0, y: 0, distance: placing.scale * (6 * mesh.far), centre: mesh.centre,
    px: px * fine, cx: (width / 2 + panX) * fine, cy: (height / 2 + panY) * fine };
  const flat = { ...look, px, cx: x + width / 2 + panX, cy: y + height / 2 + panY }, above = floor && tiltOf(look.matrix) >= 0;
  if (above) drawFloor(ctx, mesh, flat);
  raster(target, mesh, look, true);
  stamp(ctx, target, colours, x, y, width, height);
  if (floor && !above) drawFloor(ctx, mesh, flat);
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
  if (drawn) drawShape(ctx, drawn, one, { ...shared, x: 0, y: 0, colours: kept.colours.clay });
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
