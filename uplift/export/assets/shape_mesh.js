// Meshes: the embedded corners and triangles of each, its normals, and how it is turned.
const MESHES = [];
const CREASE = 0.6; // cosine of the angle above which an edge stays sharp

function listMeshes() {
  let vertex = 0, face = 0;
  for (const [vertices, faces] of meta.meshes) {
    MESHES.push({ vertex, face, vertices, faces, ready: null });
    vertex += vertices; face += faces;
  }
}

// Decoded when it is first drawn.
function meshOf(index) {
  if (index < 0) return null;
  const place = MESHES[index];
  if (place.ready) return place.ready;
  const points = new Float32Array(3 * place.vertices), faces = new Uint16Array(3 * place.faces);
  for (let k = 0; k < points.length; k++) points[k] = value(kept.arrays.vertices, 3 * place.vertex + k);
  for (let k = 0; k < faces.length; k++) faces[k] = value(kept.arrays.faces, 3 * place.face + k);
  const column = (name, width, k) => (kept.arrays[name] ? Float32Array.from({ length: place.vertices }, (_, n) => value(kept.arrays[name], width * (place.vertex + n) + k)) : null);
  place.ready = { points, faces, normals: cornerNormals(points, faces, welded(points)), sky: column('sky', 1, 0), across: column('place', 2, 0), down: column('place', 2, 1), doubt: column('doubt', 1, 0), ...box(points) };
  return place.ready;
}

// Corners that are doubled along a texture's seam count as one for the light.
function welded(points) {
  const first = new Map(), found = new Uint16Array(points.length / 3);
  for (let k = 0; k < found.length; k++) {
    const key = `${points[3 * k]},${points[3 * k + 1]},${points[3 * k + 2]}`;
    if (!first.has(key)) first.set(key, k);
    found[k] = first.get(key);
  }
  return found;
}

// `wide` and `tall` are half the sizes about the middle of the box, `far` is from the origin.
function box(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < points.length; k++) { low[k % 3] = Math.min(low[k % 3], points[k]); high[k % 3] = Math.max(high[k % 3], points[k]); }
  const centre = low.map((v, a) => (v + high[a]) / 2);
  let wide = 1e-6, far = 1e-6;
  for (let k = 0; k < points.length; k += 3) {
    wide = Math.max(wide, Math.hypot(points[k] - centre[0], points[k + 2] - centre[2]));
    far = Math.max(far, Math.hypot(points[k], points[k + 1], points[k + 2]));
  }
  return { low, high, centre, wide, far, tall: (high[1] - low[1]) / 2 };
}

// A normal for each corner of each triangle: the mean of those around it that do not lie across a crease.
function cornerNormals(points, faces, same) {
  const count = faces.length / 3, flat = new Float32Array(3 * count), size = new Float32Array(count), around = Array.from({ length: points.length / 3 }, () => []);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * faces[3 * f + k]), u = [0, 1, 2].map((k) => points[b + k] - points[a + k]), v = [0, 1, 2].map((k) => points[c + k] - points[a + k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    size[f] = Math.hypot(...n) || 1e-12;
    for (let k = 0; k < 3; k++) { flat[3 * f + k] = n[k] / size[f]; around[same[faces[3 * f + k]]].push(f); }
  }
  const normals = new Float32Array(9 * count);
  for (let corner = 0; corner < 3 * count; corner++) {
    const own = 3 * ((corner / 3) | 0);
    let x = 0, y = 0, z = 0;
    for (const f of around[same[faces[corner]]]) {
      const near = flat[own] * flat[3 * f] + flat[own + 1] * flat[3 * f + 1] + flat[own + 2] * flat[3 * f + 2];
      if (near < CREASE) continue;
      x += size[f] * flat[3 * f]; y += size[f] * flat[3 * f + 1]; z += size[f] * flat[3 * f + 2];
    }
    const length = Math.hypot(x, y, z) || 1;
    normals[3 * corner] = x / length; normals[3 * corner + 1] = y / length; normals[3 * corner + 2] = z / length;
  }
  return normals;
}

// Rotations, rows first. Positive: aboutY turns z towards x, aboutX turns y towards z.
const aboutY = (a) => [Math.cos(a), 0, Math.sin(a), 0, 1, 0, -Math.sin(a), 0, Math.cos(a)];
const aboutX = (a) => [1, 0, 0, 0, Math.cos(a), -Math.sin(a), 0, Math.sin(a), Math.cos(a)];
const times = (p, q) => p.map((_, k) => { const r = 3 * ((k / 3) | 0), c = k % 3; return p[r] * q[c] + p[r + 1] * q[c + 3] + p[r + 2] * q[c + 6]; });
const azimuthOf = (view) => Math.atan2(view[2], view[0]);
const tiltOf = (view) => Math.atan2(view[7], view[4]);

// The shape as the camera sees it that walked round it by `turn` and rose by `lift`.
const turned = (view, turn, lift = 0) => times(aboutX(lift), times(view, aboutY(turn)));
