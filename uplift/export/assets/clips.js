// Clips: the list, finding in it, stepping through it; photos; and who of a clip is shown.
const FINDABLE = 12;

function stepClip(by) {
  const at = kept.listed.indexOf(state.clip), next = Math.max(0, Math.min(kept.listed.length - 1, at + by));
  if (kept.listed[next] !== state.clip) openClip(kept.listed[next]);
}

// Lists the clips whose names hold all words of the text; all of them where none does.
function listClips(text = '') {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean), all = kept.clips.map((_, n) => n);
  const found = all.filter((n) => words.every((word) => kept.clips[n].name.toLowerCase().includes(word)));
  kept.listed = found.length ? found : all;
  byId('find').setAttribute('aria-invalid', !found.length);
  byId('clip').replaceChildren(...kept.listed.map((n) => new Option(kept.clips[n].name, n)));
  if (kept.size && !kept.listed.includes(state.clip)) openClip(kept.listed[0]);
  byId('clip').value = state.clip;
}

function wireClips() {
  const { clips } = kept;
  kept.stills = clips.length > 1 && clips.every((clip) => clip.frames.length < 2);
  byId('clip-box').hidden = clips.length < 2;
  byId('find').hidden = clips.length <= FINDABLE;
  byId('transport').hidden = clips.length < 2 && clips[0].frames.length < 2;
  byId('play').hidden = byId('speed').hidden = kept.stills;
  byId('clip-name').textContent = meta.noun[0].toUpperCase() + meta.noun.slice(1);
  byId('clip').onchange = (event) => openClip(Number(event.target.value));
  byId('find').oninput = (event) => listClips(event.target.value);
  byId('before').onclick = () => stepClip(-1);
  byId('after').onclick = () => stepClip(1);
  listClips();
}

// One button for each individual of the clip; pressed while it is shown.
function showPeople() {
  const names = clipNow().individuals, box = byId('people');
  box.hidden = names.length < 2;
  document.querySelector('[data-toggle=tint]').hidden = names.length < 2;
  if (box.dataset.names !== JSON.stringify(names)) {
    box.dataset.names = JSON.stringify(names);
    box.replaceChildren(...names.map((name, who) => {
      const button = document.createElement('button'), swatch = document.createElement('i');
      Object.assign(button, { type: 'button', className: 'chip', title: `Show or hide ${name}` });
      swatch.className = 'p' + (who % PEOPLE);
      button.append(swatch, name);
      button.onclick = () => { if (!kept.hidden.delete(name)) kept.hidden.add(name); show(); };
      return button;
    }));
  }
}

function tellPeople() {
  clipNow().individuals.forEach((name, who) => byId('people').children[who]?.setAttribute('aria-pressed', !kept.hidden.has(name)));
}
