// Colours: read from the style sheet, each as a ramp from near (its own) to far (towards the paper).
const SIDES = ['middle', 'left', 'right'];
const PEOPLE = 6;
const LEVELS = 12;

function palette() {
  const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue('--' + name).trim();
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  const paper = rgb(read('paper'));
  const ramp = (name) => Array.from({ length: LEVELS }, (_, k) => {
    const mix = 0.6 * (k / (LEVELS - 1)) ** 1.4;
    return `rgb(${rgb(read(name)).map((c, a) => Math.round(c + (paper[a] - c) * mix)).join()})`;
  });
  return { paper: read('paper'), ink: read('ink'), soft: read('soft'), faint: read('faint'), floor: read('floor'),
    truth: ramp('truth'), hues: [...SIDES, ...Array.from({ length: PEOPLE }, (_, k) => 'p' + k)].map(ramp) };
}

function shade(ramp, depth) { return ramp[Math.min(LEVELS - 1, Math.max(0, Math.round(((depth + 1) / 2) * (LEVELS - 1))))]; }

// The ramp of a part of a figure: its own, or its individual's.
function rampOf(figure, hue) { return kept.colours.hues[state.tint ? SIDES.length + (figure.who % PEOPLE) : hue]; }

// Sides colour a body; where there are none, every branch from the root has a colour of its own.
function huesOf() {
  if (meta.jointSides.some(Boolean)) return { joints: meta.jointSides, bones: meta.boneSides };
  const joints = meta.joints.map(() => 0), bones = meta.bones.map(() => 0), queue = [meta.root], met = new Set(queue);
  let branches = 0;
  for (const from of queue) {
    meta.bones.forEach(([a, b], n) => {
      const to = a === from ? b : b === from ? a : -1;
      if (to < 0 || met.has(to)) return;
      met.add(to); queue.push(to);
      joints[to] = bones[n] = joints[from] || SIDES.length + (branches++ % PEOPLE);
    });
  }
  return { joints, bones };
}

const HUES = huesOf();
