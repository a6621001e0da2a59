'use strict';
const study = JSON.parse(document.getElementById('study').textContent);
const element = id => document.getElementById(id);
const PAUSE = 250; // ms from view to view: slow enough to look, fast enough to see flicker between views
const APART = 0.08; // s that videos may drift apart before they are set again

// Answers: what is kept in this browser, and the file that is sent back.

const KEPT = 'diga3d-study-' + study.study;
let state = load();

function fresh() {
  const bytes = crypto.getRandomValues(new Uint8Array(8));
  return { participant: Array.from(bytes, byte => byte.toString(16).padStart(2, '0')).join(''), at: 0, chosen: {} };
}

function load() {
  try {
    const kept = JSON.parse(localStorage.getItem(KEPT));
    const codes = new Map(study.questions.map(each => [each.code, each.candidates.map(other => other.code)]));
    const known = ([code, choice]) => codes.has(code) && codes.get(code).includes(choice);
    if (kept && /^[0-9a-f]{16}$/.test(kept.participant)) {
      const at = Number.isInteger(kept.at) ? Math.min(Math.max(kept.at, 0), study.questions.length) : 0;
      return { participant: kept.participant, at, chosen: Object.fromEntries(Object.entries(kept.chosen).filter(known)) };
    }
  } catch { /* nothing is kept, or the browser keeps nothing: start anew */ }
  return fresh();
}

function keep() {
  try {
    localStorage.setItem(KEPT, JSON.stringify(state));
  } catch {
    element('unkept').hidden = false;
  }
}

function crc32(text) {
  let crc = -1;
  for (const byte of new TextEncoder().encode(text)) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return (crc ^ -1) >>> 0;
}

// The order of candidates: shuffled anew for each question and participant, the same after a reload.
function shuffled(question) {
  let seed = crc32(state.participant + question.code);
  const random = () => { // mulberry32
    seed = (seed + 0x6d2b79f5) | 0;
    let mixed = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 4294967296;
  };
  const order = question.candidates.slice();
  for (let last = order.length - 1; last > 0; last--) {
    const other = Math.floor(random() * (last + 1));
    [order[last], order[other]] = [order[other], order[last]];
  }
  return order;
}

function votes() {
  const answers = study.questions.filter(question => question.code in state.chosen).map(question => ({
    question: question.code,
    choice: state.chosen[question.code],
    order: shuffled(question).map(candidate => candidate.code),
  }));
  const body = {
    form: 'diga3d-votes-1', study: study.study, participant: state.participant, saved: new Date().toISOString(),
    answers, sealed: study.sealed,
  };
  return { ...body, checksum: crc32(JSON.stringify(body)).toString(16).padStart(8, '0') };
}

// Showing: source and candidates run in step, as views drawn on canvases or as videos.

let playing = !matchMedia('(prefers-reduced-motion: reduce)').matches;
let stage = null;

function missing() {
  element('missing').textContent = 'Some pictures are missing: keep the folder that came with this page beside it.';
  element('missing').hidden = false;
}

function views(figures) {
  const count = figures[0].media.length;
  let place = 0, timer = null;
  const screens = figures.map(figure => {
    const canvas = document.createElement('canvas');
    canvas.setAttribute('role', 'img');
    const pictures = figure.media.map(address => {
      const picture = new Image();
      picture.onerror = missing;
      picture.onload = () => { if (picture === pictures[place]) draw(); };
      picture.src = address;
      return picture;
    });
    const draw = () => {
      const picture = pictures[place];
      if (!picture.complete || !picture.naturalWidth) return;
      if (canvas.width !== picture.naturalWidth || canvas.height !== picture.naturalHeight) {
        canvas.width = picture.naturalWidth;
        canvas.height = picture.naturalHeight;
      }
      canvas.getContext('2d').drawImage(picture, 0, 0);
    };
    return { canvas, draw, pictures };
  });
  const go = to => {
    place = (to + count) % count;
    screens.forEach(screen => screen.draw());
    element('slider').value = place;
  };
  const ready = () => screens.every(screen => screen.pictures[(place + 1) % count].complete);
  return {
    elements: screens.map(screen => screen.canvas),
    most: count - 1,
    go,
    step: by => go(place + by),
    play: on => {
      clearInterval(timer);
      if (on && count > 1) timer = setInterval(() => { if (ready()) go(place + 1); }, PAUSE);
    },
    close: () => clearInterval(timer),
  };
}

// Safari plays no video from a data URL.
function blobOf(address) {
  const bytes = Uint8Array.from(atob(address.slice(address.indexOf(',') + 1)), letter => letter.charCodeAt(0));
  return URL.createObjectURL(new Blob([bytes], { type: 'video/webm' }));
}

function videos(figures) {
  const made = [];
  const screens = figures.map(figure => {
    const video = document.createElement('video');
    Object.assign(video, { muted: true, loop: true, playsInline: true, preload: 'auto' });
    video.onerror = missing;
    video.src = figure.media[0].startsWith('data:') ? blobOf(figure.media[0]) : figure.media[0];
    if (video.src.startsWith('blob:')) made.push(video.src);
    return video;
  });
  const [first, ...others] = screens;
  const RATE = 30;
  const length = () => Number.isFinite(first.duration) ? first.duration : 4;
  let open = true;
  const inStep = () => {
    if (!open) return;
    for (const video of others) {
      const off = Math.abs(video.currentTime - first.currentTime);
      if (!first.seeking && !video.seeking && off > APART && off < length() - APART) video.currentTime = first.currentTime;
    }
    if (document.activeElement !== element('slider') || !first.paused) element('slider').value = first.currentTime * RATE;
    requestAnimationFrame(inStep);
  };
  const go = to => {
    const time = ((to / RATE) % length() + length()) % length();
    for (const video of screens) video.currentTime = time;
  };
  first.onloadedmetadata = () => { element('slider').max = Math.max(Math.round(length() * RATE) - 1, 1); };
  requestAnimationFrame(inStep);
  return {
    elements: screens,
    most: 119,
    go,
    step: by => go(Math.round(first.currentTime * RATE) + by),
    play: on => {
      for (const video of screens) on ? video.play().catch(() => {}) : video.pause();
      if (!on) for (const video of others) video.currentTime = first.currentTime;
    },
    close: () => {
      open = false;
      screens.forEach(video => { video.onerror = null; video.removeAttribute('src'); video.load(); });
      made.forEach(URL.revokeObjectURL);
    },
  };
}

function setPlaying(on) {
  playing = on;
  element('play').textContent = on ? '❚❚' : '▶';
  element('play').setAttribute('aria-label', on ? 'Pause' : 'Play');
  if (stage) stage.play(on);
}

// The page.

function button(text, press) {
  const made = document.createElement('button');
  made.textContent = text;
  made.onclick = press;
  return made;
}

function show() {
  if (stage) stage.close();
  stage = null;
  const done = state.at === study.questions.length;
  element('question').hidden = done;
  element('end').hidden = !done;
  element('transport').hidden = done;
  element('keys').hidden = done;
  element('choices').style.visibility = done ? 'hidden' : '';
  element('progress').textContent = done ? 'All questions' : `Question ${state.at + 1} of ${study.questions.length}`;
  element('back').disabled = state.at === 0;
  element('next').hidden = done;
  element('next').textContent = state.at === study.questions.length - 1 ? 'Finish ›' : 'Next ›';
  element('missing').hidden = true;
  if (done) {
    const left = study.questions.length - Object.keys(state.chosen).length;
    element('answered').textContent = left
      ? `${left} of ${study.questions.length} questions ${left === 1 ? 'is' : 'are'} not answered yet: you can go back.`
      : 'You answered all questions.';
    element('said').textContent = '';
    element('text').hidden = true;
  } else {
    showQuestion(study.questions[state.at]);
  }
  mark();
  scrollTo(0, 0);
  document.querySelector('main:not([hidden]) h1').focus({ preventScroll: true });
}

function showQuestion(question) {
  const order = shuffled(question);
  element('instruction').textContent = question.instruction;
  element('ask').textContent = question.ask;
  element('object').hidden = !question.object;
  if (question.object) element('object').querySelector('img').src = question.object;
  const film = question.source[0].startsWith('data:video') || question.source[0].endsWith('.webm');
  stage = (film ? videos : views)([{ media: question.source }, ...order]);
  element('slider').max = stage.most;
  element('transport').hidden = stage.most < 1;
  const figures = stage.elements.map((screen, place) => {
    const figure = document.createElement('figure'), caption = document.createElement('figcaption');
    const name = document.createElement('b');
    name.textContent = place ? `Result ${place}` : 'Before the edit';
    screen.setAttribute('aria-label', name.textContent);
    caption.append(name);
    if (place) {
      figure.dataset.place = place;
      caption.append(button(`Choose ${place}`, () => choose(place)));
    }
    figure.append(screen, caption);
    return figure;
  });
  element('grid').className = order.length === 4 ? 'four' : '';
  element('grid').replaceChildren(...figures);
  element('choices').replaceChildren(...order.map((_, place) => {
    const made = button(String(place + 1), () => choose(place + 1));
    made.setAttribute('aria-label', `Result ${place + 1}`);
    return made;
  }));
  element('last').textContent = order.length;
  stage.go(0);
  setPlaying(playing);
}

// What is chosen, wherever it shows.
function mark() {
  const question = study.questions[state.at];
  if (question) {
    const chosen = 1 + shuffled(question).findIndex(candidate => candidate.code === state.chosen[question.code]);
    for (const figure of element('grid').querySelectorAll('[data-place]')) {
      const is = Number(figure.dataset.place) === chosen;
      figure.classList.toggle('chosen', is);
      figure.querySelector('button').setAttribute('aria-pressed', is);
      figure.querySelector('button').textContent = is ? '✓ Chosen' : `Choose ${figure.dataset.place}`;
    }
    [...element('choices').children].forEach((each, place) => each.setAttribute('aria-pressed', place + 1 === chosen));
    element('next').disabled = !chosen;
  }
  element('dots').hidden = study.questions.length === 1;
  element('dots').replaceChildren(...study.questions.map((each, place) => {
    const dot = button(String(place + 1), () => go(place));
    dot.className = each.code in state.chosen ? 'done' : '';
    dot.setAttribute('aria-label', `Question ${place + 1}${each.code in state.chosen ? ', answered' : ''}`);
    if (place === state.at) dot.setAttribute('aria-current', 'step');
    return dot;
  }));
}

function choose(place) {
  const question = study.questions[state.at];
  const candidate = question && shuffled(question)[place - 1];
  if (!candidate) return;
  state.chosen[question.code] = candidate.code;
  keep();
  mark();
}

function go(to) {
  if (to < 0 || to > study.questions.length) return;
  state.at = to;
  keep();
  show();
}

function next() {
  if (state.at < study.questions.length && study.questions[state.at].code in state.chosen) go(state.at + 1);
}

element('back').onclick = () => go(state.at - 1);
element('next').onclick = next;
element('play').onclick = () => setPlaying(!playing);
element('slider').oninput = event => {
  setPlaying(false);
  stage.go(Number(event.target.value));
};
element('save').onclick = () => {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([JSON.stringify(votes(), null, 2) + '\n'], { type: 'application/json' }));
  link.download = `votes_${study.study.slice(0, 6)}_${state.participant.slice(0, 6)}.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  element('said').textContent = `Saved as ${link.download} in your folder of downloads.`;
};
element('copy').onclick = () => {
  const text = element('text');
  text.value = JSON.stringify(votes(), null, 2);
  text.hidden = false;
  text.select();
  const said = done => {
    element('said').textContent = done ? 'Copied: paste it into a message.' : 'Copy the text below into a message.';
  };
  if (navigator.clipboard) navigator.clipboard.writeText(text.value).then(() => said(true), () => said(false));
  else said(false);
};
element('another').onclick = () => {
  if (!confirm('Answers that were not saved are lost. Start anew?')) return;
  state = fresh();
  keep();
  show();
};
document.addEventListener('keydown', event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const on = event.target.tagName;
  const inText = on === 'TEXTAREA', inSlider = on === 'INPUT';
  if (inText) return;
  if (/^[1-9]$/.test(event.key)) choose(Number(event.key));
  else if (inSlider) return;
  else if (event.key === 'ArrowLeft') go(state.at - 1);
  else if (event.key === 'ArrowRight') next();
  else if (stage && (event.key === 'ArrowUp' || event.key === 'ArrowDown')) {
    setPlaying(false);
    stage.step(event.key === 'ArrowUp' ? -1 : 1);
  } else if (stage && event.key === ' ' && on !== 'BUTTON') setPlaying(!playing);
  else return;
  event.preventDefault();
});
keep();
show();
