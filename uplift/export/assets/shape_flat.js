// Flat views: the mask under the lifted silhouette, and the silhouettes of the turned shape.
const TURNS = 8;

// 255 where the shape covers a pixel of its crop; turned shapes are seen about (x, y), `reach` units to each side.
function silhouette(index, placing, side, turn = 0, [x, y] = [0, 0], reach = 1) {
  const target = bufferOf(side, side), mesh = meshOf(index), px = side / 2 / reach;
  const look = { matrix: turned(placing.view, turn), scale: placing.scale, x: placing.offset[0] - x, y: placing.offset[1] - y, distance: placing.distance ?? Infinity, px, cx: side / 2, cy: side / 2 };
  if (mesh) raster(target, mesh, look, false);
  return target.light.slice();
}

// How far the shapes of an item reach from where the lifted one stands, however they are turned.
function reachOf(one) {
  const reach = (mesh, placing) => (mesh ? placing.scale * mesh.far + Math.hypot(placing.offset[0] - one.offset[0], placing.offset[1] - one.offset[1]) : 0);
  return 1.04 * Math.max(1e-6, reach(meshOf(one.mesh), one), one.truth ? reach(meshOf(one.truth.mesh), one.truth) : 0);
}

// The mask at so many pixels a side, between its pixels by their four neighbours; 255 where at least half is covered.
function maskAt(item, side) {
  const small = meta.side, M = kept.arrays.masks, from = Float32Array.from({ length: small * small }, (_, k) => value(M, item * small * small + k));
  const found = new Uint8Array(side * side), last = small - 1, left = new Int32Array(side), right = new Int32Array(side), share = new Float32Array(side);
  for (let k = 0; k < side; k++) {
    const at = ((k + 0.5) * small) / side - 0.5, low = Math.floor(at);
    share[k] = at - low; left[k] = Math.max(0, low); right[k] = Math.min(last, low + 1);
  }
  for (let y = 0, k = 0; y < side; y++) {
    const upper = small * left[y], lower = small * right[y], down = share[y];
    for (let x = 0; x < side; x++, k++) {
      const l = left[x], r = right[x], t = share[x], above = from[upper + l] + (from[upper + r] - from[upper + l]) * t, below = from[lower + l] + (from[lower + r] - from[lower + l]) * t;
      if (above + (below - above) * down >= 0.5) found[k] = 255;
    }
  }
  return found;
}

function overlap(wanted, lifted) {
  let both = 0, any = 0;
  for (let k = 0; k < wanted.length; k++) { if (wanted[k] && lifted[k]) both++; if (wanted[k] || lifted[k]) any++; }
  return any ? both / any : NaN;
}

// Colours: nothing, too much, missing of `wanted`, both.
function compare(ctx, side, wanted, lifted, colours, size) {
  const light = new Uint8Array(side * side);
  for (let k = 0; k < light.length; k++) light[k] = (wanted[k] & 2) | (lifted[k] & 1);
  stamp(ctx, { width: side, height: side, light }, colours, 0, 0, size, size);
}

function fitCanvas(canvas) {
  const ratio = Math.max(1, window.devicePixelRatio || 1), { width, height } = canvas.getBoundingClientRect();
  const wide = Math.max(1, Math.round(width * ratio)), high = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== wide || canvas.height !== high) { canvas.width = wide; canvas.height = high; }
  const ctx = canvas.getContext('2d');
  ctx.setTransform(wide / Math.max(width, 1), 0, 0, high / Math.max(height, 1), 0, 0);
  ctx.clearRect(0, 0, width, height);
  return { ctx, width, height, ratio };
}

// The input: the photo where there is one, the mask and the lifted silhouette over it; returns how well they agree.
function drawInput(canvas, item, photo) {
  const { ctx, width } = fitCanvas(canvas), side = Math.min(640, Math.max(128, 2 * Math.round(width))), one = meta.items[item];
  const shown = photo && state.photo, wanted = maskAt(item, side), lifted = silhouette(one.mesh, one, side);
  if (shown) ctx.drawImage(photo, 0, 0, width, width);
  compare(ctx, side, wanted, lifted, shown ? kept.colours.over : kept.colours.agree, width);
  return overlap(wanted, lifted);
}

// One turned silhouette, against the true shape's where that is known; returns how well they agree.
function drawTurn(canvas, item, turn) {
  const { ctx, width } = fitCanvas(canvas), side = Math.min(320, Math.max(96, 2 * Math.round(width))), one = meta.items[item];
  const reach = reachOf(one), lifted = silhouette(one.mesh, one, side, turn, one.offset, reach), { solid, agree } = kept.colours;
  if (!one.truth || !state.truth) { compare(ctx, side, lifted, lifted, solid, width); return NaN; }
  const wanted = silhouette(one.truth.mesh, one.truth, side, turn, one.offset, reach);
  compare(ctx, side, wanted, lifted, agree, width);
  return overlap(wanted, lifted);
}
