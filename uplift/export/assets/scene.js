// Scene: where every joint stands in the drawn world, how large that world is, and the eye that looks at it.
// World axes are those of the data: x right, y down, z away.
const SAMPLES = 80;

// Fills out (joints x 3, NaN where absent) relative to the root; returns the lowest y.
function poseRow(A, row, name, level, out) {
  const { codes, step, offset } = A[name], R = 9 * row, base = 3 * J * row;
  let lowest = -Infinity;
  for (let k = 0; k < 3 * J; k += 3) {
    if (codes[base + k] === ABSENT) { out[k] = out[k + 1] = out[k + 2] = NaN; continue; }
    const x = codes[base + k] * step + offset, y = codes[base + k + 1] * step + offset, z = codes[base + k + 2] * step + offset;
    out[k] = level ? value(A.level, R) * x + value(A.level, R + 1) * y + value(A.level, R + 2) * z : x;
    out[k + 1] = level ? value(A.level, R + 3) * x + value(A.level, R + 4) * y + value(A.level, R + 5) * z : y;
    out[k + 2] = level ? value(A.level, R + 6) * x + value(A.level, R + 7) * y + value(A.level, R + 8) * z : z;
    if (out[k + 1] > lowest) lowest = out[k + 1];
  }
  return lowest;
}

// Fills shift with where the root stands: its own place, or its slot in the row of individuals.
// Feet are put on the floor wherever no height is known.
function rootOf(A, row, who, lowest, shift) {
  const placed = state.placed && A.place, P = state.level ? A.levelPlace : A.place;
  for (let a = 0; a < 3; a++) shift[a] = placed ? value(P, 3 * row + a) : 0;
  if (!placed) shift[0] = kept.slots[who];
  if (floored() && !(placed && meta.rooted)) shift[1] = lowest > -Infinity ? -lowest : 0;
}

function floored() { return state.level && meta.gravity; }

function moveBy(out, shift) {
  for (let k = 0; k < 3 * J; k += 3) { out[k] += shift[0]; out[k + 1] += shift[1]; out[k + 2] += shift[2]; }
}

function sampled(clip) {
  const every = Math.max(1, Math.ceil(clip.moments.length / SAMPLES));
  return clip.moments.filter((_, m) => m % every === 0).flat();
}

// The x of each individual in a row, in the order in which they stand in the image; nobody overlaps.
function lineUp(A, clip) {
  const buffer = new Float64Array(3 * J), people = clip.individuals.map((_, who) => ({ who, wide: 0, at: [] }));
  for (const row of sampled(clip)) {
    const one = people[value(A.individual, row)];
    poseRow(A, row, 'pose', state.level, buffer);
    for (let k = 0; k < 3 * J; k++) if (k % 3 !== 1 && Math.abs(buffer[k]) > one.wide) one.wide = Math.abs(buffer[k]);
    if (A.place) one.at.push(value(A.place, 3 * row));
  }
  const middle = (one) => one.at.sort((a, b) => a - b)[one.at.length >> 1] ?? 0;
  const ordered = people.map((one) => ({ ...one, middle: middle(one) })).sort((a, b) => a.middle - b.middle);
  const slots = new Float64Array(people.length);
  let at = 0;
  ordered.forEach((one, n) => { at += n ? 0.8 * (one.wide + ordered[n - 1].wide) : 0; slots[one.who] = at; });
  return slots.map((x) => x - at / 2);
}

// Centre, half sizes, floor and mean lengths of bones of a clip; a stray row does not stretch it.
// The floor is where most lowest joints are: places are not sure to the centimetre.
function measure(A, clip) {
  const low = [[], [], []], high = [[], [], []], rows = [], buffer = new Float64Array(3 * J), shift = new Float64Array(3);
  const lengths = new Float64Array(B), counts = new Float64Array(B);
  for (const row of sampled(clip)) {
    const lowest = poseRow(A, row, 'pose', state.level, buffer);
    meta.bones.forEach(([a, b], n) => {
      const length = Math.hypot(buffer[3 * a] - buffer[3 * b], buffer[3 * a + 1] - buffer[3 * b + 1], buffer[3 * a + 2] - buffer[3 * b + 2]);
      if (length >= 0) { lengths[n] += length; counts[n]++; }
    });
    if (lowest === -Infinity) continue;
    rootOf(A, row, value(A.individual, row), lowest, shift);
    moveBy(buffer, shift);
    for (let a = 0; a < 3; a++) {
      const line = buffer.filter((v, k) => k % 3 === a && v === v);
      low[a].push(Math.min(...line)); high[a].push(Math.max(...line));
    }
    rows.push([low[0].at(-1), high[0].at(-1), low[2].at(-1), high[2].at(-1)]);
  }
  const at = (list, share) => (list.length ? list.sort((a, b) => a - b)[Math.round(share * (list.length - 1))] : 0);
  const from = low.map((list) => at(list, 0.01)), to = high.map((list) => at(list, 0.99));
  const half = from.map((v, a) => (to[a] - v) / 2), radius = Math.max(Math.hypot(...half), 1e-6), centre = from.map((v, a) => (v + to[a]) / 2);
  // Turned about its middle, a scene is as wide as its farthest row is away.
  const reach = rows.map((row) => Math.max(...[0, 1].map((x) => Math.max(...[2, 3].map((z) => Math.hypot(row[x] - centre[0], row[z] - centre[2]))))));
  return { centre, half, radius, floor: at(high[1], 0.8), lengths: lengths.map((sum, n) => sum / (counts[n] || 1)),
    wide: Math.max(at(reach, 0.99), radius * 0.3), tall: Math.max(half[1], radius * 0.3) };
}

// A function that writes screen x, y, depth (-1 near .. 1 far) and magnification of a world point into out[at...].
function eye(size, view, width, height) {
  const scale = Math.min((0.46 * width) / size.wide, (0.4 * height) / size.tall) * view.zoom;
  const distance = 4.5 * size.radius, [cx, cy, cz] = size.centre;
  const cosYaw = Math.cos(view.yaw), sinYaw = Math.sin(view.yaw), cosPitch = Math.cos(view.pitch), sinPitch = Math.sin(view.pitch);
  const look = (x, y, z, out, at = 0) => {
    x -= cx; y -= cy; z -= cz;
    const turned = cosYaw * x + sinYaw * z, away = cosYaw * z - sinYaw * x;
    const down = cosPitch * y - sinPitch * away, depth = cosPitch * away + sinPitch * y;
    const near = distance / Math.max(distance + depth, 0.15 * distance);
    out[at] = width / 2 + view.panX + turned * near * scale;
    out[at + 1] = height / 2 + view.panY + down * near * scale;
    out[at + 2] = Math.max(-1, Math.min(1, depth / size.radius));
    out[at + 3] = near;
  };
  look.scale = scale;
  return look;
}
