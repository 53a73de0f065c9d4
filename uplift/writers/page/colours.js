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
    truth: ramp('truth'), sides: SIDES.map(ramp), people: Array.from({ length: PEOPLE }, (_, k) => ramp('p' + k)) };
}

function shade(ramp, depth) { return ramp[Math.min(LEVELS - 1, Math.max(0, Math.round(((depth + 1) / 2) * (LEVELS - 1))))]; }

// The ramp of a part of a figure: its side's, or its individual's.
function rampOf(figure, side) { return state.tint ? kept.colours.people[figure.who % PEOPLE] : kept.colours.sides[side]; }
