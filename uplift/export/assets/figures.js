// Figures: the buffers of everyone on the screen. They are kept and filled anew, so that playing allocates nothing.
const B = meta.bones.length, J = meta.joints.length;
const pool = [];

function newFigure() {
  const floats = (size) => new Float64Array(size);
  return { row: 0, who: 0, name: '', wide: null, world: floats(3 * J), points: floats(4 * J), truthWorld: floats(3 * J), truth: floats(4 * J),
    hasTruth: false, flat: floats(2 * J), ground: floats(4 * J), front: floats(J), shift: floats(3), away: floats(3) };
}

const sureOf = (figure, j) => Math.min(1, value(kept.arrays.confidence, figure.row * J + j));
const filledAt = (figure, j) => value(kept.arrays.filled, figure.row * J + j) > 0.5;
const uncertaintyOf = (figure, j) => (kept.arrays.uncertainty ? value(kept.arrays.uncertainty, figure.row * J + j) : NaN);

// Fills kept.figures with the individuals of this moment that are not hidden.
function fillFigures(look, see) {
  const A = kept.arrays, clip = clipNow();
  kept.figures.length = 0;
  for (const row of clip.moments[state.moment]) {
    const who = value(A.individual, row);
    if (kept.hidden.has(clip.individuals[who])) continue;
    const figure = (pool[kept.figures.length] ??= newFigure());
    figure.row = row; figure.who = who;
    if (figure.name !== clip.individuals[who]) { figure.name = clip.individuals[who]; figure.wide = null; }
    const lowest = poseRow(A, row, 'pose', state.level, figure.world);
    rootOf(A, row, who, lowest, figure.shift);
    moveBy(figure.world, figure.shift);
    projectRow(look, figure.world, figure.points);
    figure.hasTruth = Boolean(A.truth && state.truth);
    if (figure.hasTruth) {
      poseRow(A, row, 'truth', state.level, figure.truthWorld);
      moveBy(figure.truthWorld, figure.shift);
      projectRow(look, figure.truthWorld, figure.truth);
    }
    for (let a = 0; a < 3; a++) figure.away[a] = state.level ? value(A.level, 9 * row + 3 * a + 2) : a === 2 ? 1 : 0;
    flatRow(A, row, see, figure.flat);
    kept.figures.push(figure);
  }
}

// Projects a placed row: joints x (screen x, y, depth, magnification); onto the height y where one is given.
function projectRow(look, world, out, y = null) {
  for (let j = 0; j < J; j++) look(world[3 * j], y === null ? world[3 * j + 1] : y + 0 * world[3 * j + 1], world[3 * j + 2], out, 4 * j);
}

// The joint that stands highest on the screen, -1 where none does; stride is that of the points.
function topOf(points, stride) {
  let top = -1;
  for (let j = 0; j < J; j++) if (points[stride * j + 1] === points[stride * j + 1] && (top < 0 || points[stride * j + 1] < points[stride * top + 1])) top = j;
  return top;
}

// Widths of bones and radii of joints in px: long bones are thick, and none is thicker than it is drawn long.
function thickness(lengths, scale, most, bones, joints) {
  joints.fill(0);
  for (let n = 0; n < B; n++) {
    const [a, b] = meta.bones[n], thick = Math.max(1.2, Math.min(most, 0.8 * Math.sqrt(lengths[n] * scale)));
    bones[n] = thick;
    joints[a] = Math.max(joints[a], 0.72 * thick); joints[b] = Math.max(joints[b], 0.72 * thick);
  }
  for (let j = 0; j < J; j++) if (!joints[j]) joints[j] = 0.6 * most;
}
