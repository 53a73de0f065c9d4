// Scene: where every joint stands in the drawn world, how large that world is, and the eye that looks at it.
// World axes are those of the data: x right, y down, z away.
const point = new Float64Array(3);

// Fills out (joints x 3, NaN where absent) and returns the offset that was added to every joint.
function placeRow(A, row, name, level, out, shift) {
  const array = A[name], base = row * J * 3, R = row * 9;
  let lowest = -Infinity;
  for (let j = 0; j < J; j++) {
    for (let a = 0; a < 3; a++) {
      const code = array.codes[base + 3 * j + a];
      point[a] = code === ABSENT ? NaN : code * array.step + array.offset;
    }
    for (let a = 0; a < 3; a++) {
      out[3 * j + a] = level
        ? value(A.level, R + 3 * a) * point[0] + value(A.level, R + 3 * a + 1) * point[1] + value(A.level, R + 3 * a + 2) * point[2]
        : point[a];
    }
    if (out[3 * j + 1] > lowest) lowest = out[3 * j + 1];
  }
  if (!shift) {
    const grounded = level && meta.gravity && lowest > -Infinity;
    shift = [A.place ? value(A.place, 2 * row) : 0, grounded ? -lowest : A.place && !level ? value(A.place, 2 * row + 1) : 0];
  }
  for (let j = 0; j < J; j++) { out[3 * j] += shift[0]; out[3 * j + 1] += shift[1]; }
  return shift;
}

// Centre and half sizes of a clip, out of at most 80 of its moments.
function measure(A, clip, level) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], buffer = new Float64Array(3 * J);
  const every = Math.max(1, Math.floor(clip.moments.length / 80));
  for (let m = 0; m < clip.moments.length; m += every) {
    for (const row of clip.moments[m]) {
      placeRow(A, row, 'pose', level, buffer);
      for (let k = 0; k < 3 * J; k++) {
        const v = buffer[k], a = k % 3;
        if (v < low[a]) low[a] = v;
        if (v > high[a]) high[a] = v;
      }
    }
  }
  const centre = low.map((v, a) => (v > high[a] ? 0 : (v + high[a]) / 2));
  const half = low.map((v, a) => (v > high[a] ? 0 : (high[a] - v) / 2));
  const radius = Math.max(Math.hypot(...half), 1e-6);
  return { centre, half, radius, wide: Math.max(Math.hypot(half[0], half[2]), radius * 0.3), tall: Math.max(half[1], radius * 0.3) };
}

// Bounds of a clip's keypoints in pixels: its own extent with a margin, never a tiny crop.
function measureFlat(A, clip) {
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  const K = A.keypoints;
  for (const rows of clip.moments) {
    for (const row of rows) {
      for (let j = 0; j < J; j++) {
        const k = 2 * (row * J + j);
        if (K.codes[k] === ABSENT) continue;
        const x = value(K, k), y = value(K, k + 1);
        x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
      }
    }
  }
  if (x0 > x1) return { x: 0, y: 0, wide: 1, tall: 1, empty: true };
  const [W, H] = meta.imageSize || [0, 0];
  const margin = Math.max(x1 - x0, y1 - y0, 1e-6) * 0.12;
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, wide: Math.max(x1 - x0 + 2 * margin, W / 4), tall: Math.max(y1 - y0 + 2 * margin, H / 4) };
}

// Returns a function that writes screen x, y, depth (-1 near .. 1 far) and magnification of a world point into out.
function eye(size, view, width, height) {
  const scale = Math.min((0.46 * width) / size.wide, (0.4 * height) / size.tall) * view.zoom;
  const distance = 4.5 * size.radius, [cx, cy, cz] = size.centre;
  const cosYaw = Math.cos(view.yaw), sinYaw = Math.sin(view.yaw), cosPitch = Math.cos(view.pitch), sinPitch = Math.sin(view.pitch);
  return (x, y, z, out) => {
    x -= cx; y -= cy; z -= cz;
    const turned = cosYaw * x + sinYaw * z, away = cosYaw * z - sinYaw * x;
    const down = cosPitch * y - sinPitch * away, depth = cosPitch * away + sinPitch * y;
    const near = distance / Math.max(distance + depth, 0.15 * distance);
    out[0] = width / 2 + view.panX + turned * near * scale;
    out[1] = height / 2 + view.panY + down * near * scale;
    out[2] = Math.max(-1, Math.min(1, depth / size.radius));
    out[3] = near;
  };
}
