// Colours: read from the style sheet, as the 32 bits of a pixel (alpha, blue, green, red).
const rgbOf = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
const bits = ([r, g, b], alpha = 255) => ((alpha << 24) | (b << 16) | (g << 8) | r) >>> 0;

// From dark over its own to bright, in 256 steps of light.
function ramp(style, name) {
  const stops = ['0', '1', '2'].map((end) => rgbOf(style(name + end))), found = new Uint32Array(256);
  for (let k = 1; k < 256; k++) {
    const at = (2 * k) / 255, from = Math.min(1, at | 0), share = at - from;
    found[k] = bits(stops[from].map((c, a) => Math.round(c + (stops[from + 1][a] - c) * share)));
  }
  return found;
}

function palette() {
  const computed = getComputedStyle(document.documentElement), style = (name) => computed.getPropertyValue('--' + name).trim();
  const codes = ['extra', 'missed', 'both'], solid = bits(rgbOf(style('both')));
  return { clay: ramp(style, 'clay'), true: ramp(style, 'true'), doubt: ramp(style, 'doubt'), solid: [0, solid, solid, solid],
    agree: [0, ...codes.map((name) => bits(rgbOf(style(name))))], over: [0, ...codes.map((name) => bits(rgbOf(style(name)), name === 'both' ? 96 : 190))],
    ink: style('ink'), soft: style('soft'), faint: style('faint'), floor: style('floor') };
}
