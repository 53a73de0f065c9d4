// Data: the embedded text back to typed arrays, and rows back to clips and moments.
const ABSENT = -32768;
const meta = JSON.parse(document.getElementById('data').textContent);

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function decode(bytes) {
  const arrays = {};
  let at = 0;
  for (const item of meta.layout) {
    const size = item.shape.reduce((a, b) => a * b, 1), rows = item.shape[0], width = rows ? size / rows : 0;
    const codes = new Int16Array(size);
    for (let column = 0, k = at; column < width; column++) {
      for (let row = 0, sum = 0; row < rows; row++, k++) {
        sum = (sum + (bytes[k] | (bytes[k + size] << 8))) & 0xffff;
        codes[row * width + column] = sum;
      }
    }
    at += 2 * size;
    arrays[item.name] = { codes, width, step: item.step, offset: item.offset };
  }
  return arrays;
}

function value(array, index) { return array.codes[index] * array.step + array.offset; }

// moments[m] lists the rows that are seen at moment m.
function buildClips(arrays) {
  let start = 0;
  return meta.clips.map((clip) => {
    const moments = clip.frames.map(() => []), end = start + clip.rows;
    for (let row = start; row < end; row++) moments[value(arrays.moment, row)].push(row);
    start = end;
    return { ...clip, moments };
  });
}
