// Raster: triangles into pixels with a depth each; a pixel holds how bright it is, 0 where nothing is, and where in its picture its colour is.
const buffers = new Map();

function bufferOf(width, height) {
  const key = `${width}x${height}`;
  if (!buffers.has(key)) {
    if (buffers.size > 12) buffers.clear();
    buffers.set(key, { width, height, depth: new Float32Array(width * height), light: new Uint8Array(width * height), tint: new Int32Array(width * height) });
  }
  const found = buffers.get(key);
  found.depth.fill(Infinity); found.light.fill(0);
  return found;
}

let screen = new Float32Array(0), lights = new Float32Array(0);

// look: rotation `matrix`, then `scale`, shift `x` `y`, a camera at `distance`; `px` pixels a unit about cx, cy.
function project(points, look, centre) {
  const [a, b, c, d, e, f, g, h, i] = look.matrix, [ox, oy, oz] = centre, s = look.scale;
  if (screen.length < points.length) screen = new Float32Array(points.length);
  for (let k = 0; k < points.length; k += 3) {
    const x = points[k] - ox, y = points[k + 1] - oy, z = points[k + 2] - oz, deep = s * (g * x + h * y + i * z);
    const near = look.px / Math.max(1 + deep / look.distance, 0.05);
    screen[k] = look.cx + near * (s * (a * x + b * y + c * z) + look.x);
    screen[k + 1] = look.cy + near * (s * (d * x + e * y + f * z) + look.y);
    screen[k + 2] = deep;
  }
}

// A broad key light from the upper left, a faint one from the right, one along the rim, and the sky.
function shineOn(x, y, z, sky) {
  const key = Math.max(0, (0.2 - 0.42 * x - 0.66 * y - 0.62 * z) / 1.2), fill = Math.max(0, 0.83 * x - 0.1 * y - 0.55 * z), rim = Math.max(0, 1 + z) ** 3;
  return (0.35 + 0.65 * sky) * (150 * key + 30 * fill + 14 * rim) + sky * (30 + 42 * (0.5 - 0.5 * y));
}

function lightUp(mesh, matrix) {
  const [a, b, c, d, e, f, g, h, i] = matrix, N = mesh.normals;
  if (lights.length < N.length / 3) lights = new Float32Array(N.length / 3);
  for (let k = 0, n = 0; k < N.length; k += 3, n++) {
    lights[n] = shineOn(a * N[k] + b * N[k + 1] + c * N[k + 2], d * N[k] + e * N[k + 1] + f * N[k + 2], g * N[k] + h * N[k + 1] + i * N[k + 2], mesh.sky[mesh.faces[n]]);
  }
}

const NOWHERE = [0, 0, 0];

// `paint`: a picture's `width` and, for each corner, the row and column of its colour.
function raster(target, mesh, look, lit, paint = null) {
  project(mesh.points, look, look.centre ?? NOWHERE);
  if (lit) lightUp(mesh, look.matrix);
  const F = mesh.faces;
  for (let f = 0; f < F.length; f += 3) {
    if (lit) fillTriangle(target, 3 * F[f], 3 * F[f + 1], 3 * F[f + 2], f, paint);
    else coverTriangle(target.light, target.width, target.height, 3 * F[f], 3 * F[f + 1], 3 * F[f + 2]);
  }
}

// A silhouette's part of one triangle: on each row of pixels, those whose centre lies between its edges.
function coverTriangle(light, width, height, p, q, r) {
  const ax = screen[p], ay = screen[p + 1], bx = screen[q], by = screen[q + 1], cx = screen[r], cy = screen[r + 1];
  const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), y1 = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
  for (let y = y0; y <= y1; y++) {
    const at = y + 0.5, a = ay <= at, b = by <= at, c = cy <= at;
    if (a === b && b === c) continue;
    // Two of the three edges cross the row.
    const u = a !== b ? ax + ((at - ay) / (by - ay)) * (bx - ax) : bx + ((at - by) / (cy - by)) * (cx - bx);
    const v = c !== a ? cx + ((at - cy) / (ay - cy)) * (ax - cx) : bx + ((at - by) / (cy - by)) * (cx - bx);
    const to = Math.min(width - 1, Math.floor(Math.max(u, v) - 0.5)), row = y * width;
    for (let x = Math.max(0, Math.ceil(Math.min(u, v) - 0.5)); x <= to; x++) light[row + x] = 255;
  }
}

// Pixels whose centre is in the triangle, by its three edges; `corner` is the first of its lights.
function fillTriangle({ width, height, depth, light, tint }, p, q, r, corner, paint) {
  const ax = screen[p], ay = screen[p + 1], bx = screen[q], by = screen[q + 1], cx = screen[r], cy = screen[r + 1];
  const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
  if (!area) return;
  const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), x1 = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
  const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), y1 = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
  // Seen from behind, a triangle is dark: the surface is open there.
  const dim = area < 0 ? 1 : 0.35, l0 = lights[corner] * dim, l1 = lights[corner + 1] * dim, l2 = lights[corner + 2] * dim;
  const z0 = screen[p + 2], z1 = screen[q + 2], z2 = screen[r + 2];
  const dv = (cy - by) / area, dw = (ay - cy) / area;
  for (let y = y0; y <= y1; y++) {
    const py = y + 0.5, px = x0 + 0.5;
    let u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area, v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area;
    for (let x = x0, at = y * width + x0; x <= x1; x++, at++, u -= dv, v -= dw) {
      const w = 1 - u - v;
      if (u < -1e-7 || v < -1e-7 || w < -1e-7) continue;
      const deep = u * z0 + v * z1 + w * z2;
      if (deep >= depth[at]) continue;
      depth[at] = deep; light[at] = Math.max(1, Math.min(255, u * l0 + v * l1 + w * l2));
      if (paint) tint[at] = ((u * paint.row[p / 3] + v * paint.row[q / 3] + w * paint.row[r / 3]) | 0) * paint.width + ((u * paint.column[p / 3] + v * paint.column[q / 3] + w * paint.column[r / 3]) | 0);
    }
  }
}

// Each pixel's colour, as bright as its light: a shape's own colours are not bleached.
function shade(pixels, { light, tint }, colours) {
  for (let k = 0; k < pixels.length; k++) {
    if (!light[k]) { pixels[k] = 0; continue; }
    const c = colours[tint[k]], bright = 0.32 + light[k] / 250, part = (shift) => Math.min(255, (((c >>> shift) & 255) * bright) | 0);
    pixels[k] = ((255 << 24) | (part(16) << 16) | (part(8) << 8) | part(0)) >>> 0;
  }
}

// Pixels to a canvas by a table of colours, smoothed where the canvas is smaller.
const spare = document.createElement('canvas');

function stamp(ctx, target, table, x, y, width, height, colours = null) {
  spare.width = target.width; spare.height = target.height;
  const to = spare.getContext('2d'), image = to.createImageData(target.width, target.height), pixels = new Uint32Array(image.data.buffer);
  if (colours) shade(pixels, target, colours);
  else for (let k = 0; k < pixels.length; k++) pixels[k] = table[target.light[k]];
  to.putImageData(image, 0, 0);
  ctx.imageSmoothingQuality = 'high';
  ctx.drawImage(spare, x, y, width, height);
}
