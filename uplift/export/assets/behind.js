// The frames behind the 2D: small JPEGs that are decoded as they come near, at their place among the keypoints.
const AHEAD = 10, KEPT = 60;
const decoded = new Map();
let lastShown = null;

const behindNow = () => (meta.behind && state.video ? meta.behind[state.clip] : null);

// Starts to decode a picture, and returns what is known of it: `bitmap` once that is there.
function pictureAt(behind, at) {
  const key = state.clip + ':' + at;
  if (decoded.has(key)) return decoded.get(key);
  const picture = { bitmap: null };
  decoded.set(key, picture);
  if (decoded.size > KEPT) decoded.delete(decoded.keys().next().value);
  const bytes = Uint8Array.from(atob(behind.jpegs[at]), (letter) => letter.charCodeAt(0));
  createImageBitmap(new Blob([bytes], { type: 'image/jpeg' })).then((bitmap) => { picture.bitmap = bitmap; paint(); }, () => {});
  return picture;
}

// Draws the frame of this moment; while it is decoded, the one before it. Returns whether there is one.
function drawBehind(ctx, see) {
  const behind = behindNow();
  if (!behind) return false;
  const at = Math.floor(state.moment / behind.every);
  for (let next = at; next <= at + AHEAD && next < behind.jpegs.length; next++) if (behind.jpegs[next]) pictureAt(behind, next);
  if (!behind.jpegs[at]) return false;
  const { bitmap } = pictureAt(behind, at);
  if (bitmap) lastShown = { bitmap, behind };
  if (lastShown?.behind !== behind) return false;
  ctx.drawImage(lastShown.bitmap, see.x(behind.x), see.y(behind.y), behind.wide * see.scale, behind.tall * see.scale);
  return true;
}
