'use strict';
// Draws what the data element holds. All charts over time share one interval: dragging across one zooms all.
const DATA = JSON.parse(document.getElementById('data').textContent), RUNS = DATA.runs;
const WIDTH = RUNS.length > 1 ? 720 : 1100, LEFT = 62, RIGHT = 14, TOP = 10, BOTTOM = 24;
const HOPS = DATA.hops.map(([name]) => name), HOP_WORDS = Object.fromEntries(DATA.hops);
const CAUSES = Object.fromEntries(DATA.causes.map(([name], at) => [name, at])), CAUSE_WORDS = Object.fromEntries(DATA.causes);
const WHY = {
  latency: 'the age of the torque accounts for it (∫L)',
  designed_hold: 'the hold of the sampling accounts for it, by design (∫L)',
  fallback: 'no torque came, and the plant damped by itself (∫F₀)',
  controller_fault: 'the torque was not the law\'s (∫F)',
  uncertainty_exceeded: 'neither latency nor the torque: the disturbance or the model error is beyond what is assumed',
};
const MARKED = { 'swap': 6, 'failover': 3, 'rollback': 3, 'swap refused': 4, 'fault injected': 1, 'fallback': 1, 'member removed': 7 };

const esc = text => String(text).replace(/[&<>"]/g, c => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' }[c]));
const colour = at => `var(--s${at % 8})`;
const words = name => esc(String(name).replace(/_/g, ' '));
function number(x, digits = 4) {
  if (x === null || x === undefined || !Number.isFinite(x)) return '–';
  const size = Math.abs(x);
  if (x !== 0 && (size < 1e-3 || size >= 1e6)) return x.toExponential(Math.min(digits, 3) - 1).replace(/\.?0+e/, 'e').replace('e+', 'e').replace(/^1e/, '10^');
  return String(+x.toPrecision(digits));
}
function withUnit(x, unit) {
  const text = number(x, 3);
  return text === '–' || !unit ? text : `${text} ${esc(unit)}`;
}
// A certified bound of 0 says that the error vanishes, which no sampled loop does to the last digit.
const vanishing = (of, x) => of.ultimate_bound === 0 ? '→ 0 in continuous time' : number(x);
function duration(ns) {
  if (ns === null || ns === undefined) return '–';
  if (ns >= 1e9) return `${number(ns / 1e9, 3)} s`;
  if (ns >= 1e6) return `${number(ns / 1e6, 3)} ms`;
  return ns >= 1e3 ? `${number(ns / 1e3, 3)} µs` : `${number(ns, 3)} ns`;
}

// The interval shown, and what has to be drawn again when it changes.
const all = (pick, from) => RUNS.reduce((found, run) => run.series.t_s.length ? pick(found, run.series.t_s) : found, from);
const WHOLE = [all((low, t) => Math.min(low, t[0]), Infinity), all((high, t) => Math.max(high, t[t.length - 1]), -Infinity)];
if (!(WHOLE[0] < WHOLE[1])) { WHOLE[0] = 0; WHOLE[1] = 1; }
let shown = WHOLE.slice();
const redraws = [];
function show(from, to) {
  const least = (WHOLE[1] - WHOLE[0]) / 1e5;
  if (to - from < least) return;
  shown = [Math.max(from, WHOLE[0]), Math.min(to, WHOLE[1])];
  redraws.forEach(draw => draw());
  document.querySelectorAll('.interval').forEach(el => { el.textContent = `${(+shown[0].toFixed(6))} s to ${(+shown[1].toFixed(6))} s`; });
}

function ticksOf(low, high, log, pieces = 6) {
  const found = [];
  if (log) {
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) {
      const decades = Math.log10(high / low);
      for (const m of decades > 4 ? [1] : decades > 1.5 ? [1, 3] : [1, 2, 5]) {
        const x = m * 10 ** e;
        if (x >= low * 0.999 && x <= high * 1.001) found.push(x);
      }
    }
    return found;
  }
  const raw = (high - low) / pieces, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find(m => m * power >= raw);
  for (let k = Math.ceil(low / step); k * step <= high + step * 1e-9; k++) found.push(Math.abs(k * step) < step * 1e-9 ? 0 : k * step);
  return found;
}
const scale = (low, high, from, to, log) => log
  ? x => from + (to - from) * Math.log(Math.max(x, low * 1e-6) / low) / Math.log(high / low)
  : x => from + (to - from) * (x - low) / (high - low);

function frame(box, height, [x0, x1], [y0, y1], { xLog, yLog, xName, yName, xText }) {
  const x = scale(x0, x1, LEFT, WIDTH - RIGHT, xLog), y = scale(y0, y1, height - BOTTOM, TOP, yLog);
  let svg = '';
  for (const v of ticksOf(y0, y1, yLog)) {
    svg += `<line class="grid" x1="${LEFT}" x2="${WIDTH - RIGHT}" y1="${y(v)}" y2="${y(v)}"/><text x="${LEFT - 6}" y="${y(v) + 4}" text-anchor="end">${number(v)}</text>`;
  }
  for (const v of ticksOf(x0, x1, xLog, WIDTH / 110)) {
    svg += `<line class="grid" x1="${x(v)}" x2="${x(v)}" y1="${TOP}" y2="${height - BOTTOM}"/><text x="${x(v)}" y="${height - 8}" text-anchor="middle">${xText ? xText(v) : number(v)}</text>`;
  }
  svg += `<text x="${WIDTH - RIGHT}" y="${height - BOTTOM - 5}" text-anchor="end">${esc(xName)}</text><text x="${LEFT + 5}" y="${TOP + 11}">${esc(yName)}</text>`;
  return { svg, x, y };
}

// The intervals of a run that are shown.
function visible({ series: { t_s } }) {
  let from = 0, to = t_s.length;
  while (from < to - 1 && t_s[from + 1] < shown[0]) from++;
  while (to > from + 1 && t_s[to - 2] > shown[1]) to--;
  return [from, to];
}

// A chart over time. `lines`: {name, at: series, colour, dash}; `dots`: {t, y, colour, text}; `marks`: {t, colour, text}.
function overTime(run, { height = 210, unit, lines, dots = [], marks = [], yLog = false }) {
  const box = document.createElement('div');
  box.className = 'chart';
  const { t_s, low, high } = run.series;
  if (!t_s.length && !dots.length) {
    box.innerHTML = `<div class="empty">no recording: ${esc(run.recording)}</div>`;
    return box;
  }
  let view;
  function draw() {
    const [from, to] = visible(run);
    let [y0, y1] = [Infinity, -Infinity];
    const see = v => { if (v !== null && (!yLog || v > 0)) { y0 = Math.min(y0, v); y1 = Math.max(y1, v); } };
    // Runs of the same robot share the scale of each chart, so that they can be compared by eye.
    for (const other of RUNS) if (other.summary.links === run.summary.links) {
      const [a, b] = visible(other), series = other.series;
      for (const line of lines) for (let k = a; k < b; k++) { see(series.low[line.at][k]); see(series.high[line.at][k]); }
    }
    for (const dot of dots) if (dot.t >= shown[0] && dot.t <= shown[1]) see(dot.y);
    if (!(y0 <= y1)) { y0 = yLog ? 1 : 0; y1 = yLog ? 10 : 1; }
    if (yLog) { y0 = y0 / 1.3; y1 = y1 * 1.3; } else { const pad = (y1 - y0 || Math.abs(y1) || 1) * 0.06; y0 -= pad; y1 += pad; }
    const { svg, x, y } = frame(box, height, shown, [y0, y1], { yLog, xName: 's', yName: unit });
    let body = '';
    for (const mark of marks) if (mark.t >= shown[0] && mark.t <= shown[1]) {
      body += `<line x1="${x(mark.t)}" x2="${x(mark.t)}" y1="${TOP}" y2="${height - BOTTOM}" stroke="${mark.colour}" stroke-width="1.5" stroke-dasharray="5 3"><title>${esc(mark.text)}</title></line>`;
    }
    for (const line of lines) {
      let path = '', pen = false;
      for (let k = from; k < to; k++) {
        const a = low[line.at][k], b = high[line.at][k];
        if (a === null || (yLog && b <= 0)) { pen = false; continue; }
        const px = x(t_s[k]).toFixed(1);
        path += `${pen ? 'L' : 'M'}${px} ${y(a).toFixed(1)}`;
        if (b !== a) path += `L${px} ${y(b).toFixed(1)}`;
        pen = true;
      }
      body += `<path d="${path}" fill="none" stroke="${line.colour}" stroke-width="${line.dash ? 1.3 : 1.6}" stroke-linejoin="round" ${line.dash ? `stroke-dasharray="${line.dash}"` : ''}/>`;
    }
    for (const dot of dots) if (dot.t >= shown[0] && dot.t <= shown[1]) {
      if (dot.stem) body += `<line x1="${x(dot.t)}" x2="${x(dot.t)}" y1="${y(dot.y)}" y2="${height - BOTTOM}" stroke="${dot.colour}" opacity="0.5"/>`;
      body += `<circle cx="${x(dot.t)}" cy="${y(dot.y)}" r="3.5" fill="${dot.colour}"><title>${esc(dot.text)}</title></circle>`;
    }
    // An inner svg cuts off what lies beyond the axes.
    const inner = [LEFT, TOP - 4, WIDTH - LEFT - RIGHT, height - BOTTOM - TOP + 8];
    const clipped = `<svg x="${inner[0]}" y="${inner[1]}" width="${inner[2]}" height="${inner[3]}" viewBox="${inner.join(' ')}">`;
    box.innerHTML = `<svg viewBox="0 0 ${WIDTH} ${height}">${svg}${clipped}${body}</svg><line class="cursor" y1="${TOP}" y2="${height - BOTTOM}" visibility="hidden"/><rect class="select" y="${TOP}" height="${height - BOTTOM - TOP}" width="0"/></svg>`;
    view = { t: px => shown[0] + (px - LEFT) / (WIDTH - LEFT - RIGHT) * (shown[1] - shown[0]), x };
  }
  const place = event => {
    const at = box.getBoundingClientRect();
    return Math.min(Math.max((event.clientX - at.left) / at.width * WIDTH, LEFT), WIDTH - RIGHT);
  };
  let start = null;
  box.addEventListener('pointerdown', event => { start = place(event); });
  box.addEventListener('pointermove', event => {
    const px = place(event), select = box.querySelector('.select'), cursor = box.querySelector('.cursor');
    cursor.setAttribute('visibility', 'visible'); cursor.setAttribute('x1', px); cursor.setAttribute('x2', px);
    if (start !== null && event.buttons) { select.setAttribute('x', Math.min(px, start)); select.setAttribute('width', Math.abs(px - start)); }
    const t = view.t(px);
    let a = 0, b = t_s.length - 1;
    while (a < b) { const m = (a + b + 1) >> 1; if (t_s[m] <= t) a = m; else b = m - 1; }
    const near = (shown[1] - shown[0]) / 150;
    const rows = [`t = ${+t.toFixed(6)} s`];
    for (const line of lines) if (t_s.length && low[line.at][a] !== null) {
      const [l, h] = [low[line.at][a], high[line.at][a]];
      rows.push(`${line.name}: ${l === h ? number(l) : `${number(l)} … ${number(h)}`}`);
    }
    for (const it of [...marks, ...dots]) if (Math.abs(it.t - t) < near && rows.length < 12) rows.push(it.text);
    tip(event, rows.join('\n'));
  });
  box.addEventListener('pointerleave', () => { tip(null); box.querySelector('.cursor')?.setAttribute('visibility', 'hidden'); });
  window.addEventListener('pointerup', event => {
    if (start === null) return;
    const [a, b] = [start, place(event)].sort((p, q) => p - q);
    start = null;
    if (b - a > 4) show(view.t(a), view.t(b)); else box.querySelector('.select')?.setAttribute('width', 0);
  });
  box.addEventListener('dblclick', () => show(WHOLE[0], WHOLE[1]));
  box.addEventListener('wheel', event => {
    if (!event.ctrlKey && !event.shiftKey) return;
    event.preventDefault();
    const t = view.t(place(event)), factor = (event.deltaY || event.deltaX) > 0 ? 1.25 : 0.8;
    show(t - (t - shown[0]) * factor, t + (shown[1] - t) * factor);
  }, { passive: false });
  redraws.push(draw);
  draw();
  return box;
}
const tipBox = document.getElementById('tip');
function tip(event, text) {
  tipBox.hidden = !event;
  if (!event) return;
  tipBox.textContent = text;
  const right = event.clientX > window.innerWidth / 2;
  tipBox.style.left = right ? '' : `${event.clientX + 14}px`;
  tipBox.style.right = right ? `${window.innerWidth - event.clientX + 14}px` : '';
  tipBox.style.top = `${Math.min(event.clientY + 14, window.innerHeight - tipBox.offsetHeight - 6)}px`;
}

// Latency against 1/(1 − percentile), both on log axes, as HdrHistogram's plots have it. The same axes for all runs.
function percentileChart(run) {
  const box = document.createElement('div');
  box.className = 'chart';
  const of = r => r.percentiles.filter(([hop, steps]) => HOPS.includes(hop) && steps.length);
  const points = RUNS.flatMap(r => of(r).flatMap(([, steps]) => steps)).filter(p => p[1] > 0);
  if (!points.length) { box.innerHTML = '<div class="empty">no latencies were measured</div>'; return box; }
  const height = 300, x1 = Math.max(...points.map(p => p[0]), 100);
  const yRange = [Math.min(...points.map(p => p[1])) / 1.3, Math.max(...points.map(p => p[1])) * 1.3];
  const nines = v => { const p = 100 - 100 / v; return v <= 1 ? '0 %' : `${+p.toPrecision(Math.max(2, Math.ceil(Math.log10(v)) + 1))} %`; };
  const { svg, x, y } = frame(box, height, [1, x1], yRange, { xLog: true, yLog: true, xName: 'percentile', yName: 'µs', xText: v => Math.abs(Math.log10(v) % 1) < 1e-6 ? nines(v) : '' });
  const lines = of(run).map(([hop, steps]) => {
    const path = steps.filter(p => p[1] > 0).map(([p, us], k) => `${k ? 'L' : 'M'}${x(p).toFixed(1)} ${y(us).toFixed(1)}`).join('');
    return `<path d="${path}" fill="none" stroke="${colour(HOPS.indexOf(hop))}" stroke-width="${hop === 'round_trip' ? 2.6 : 1.6}"><title>${esc(HOP_WORDS[hop])}</title></path>`;
  });
  box.innerHTML = `<svg viewBox="0 0 ${WIDTH} ${height}">${svg}${lines.join('')}</svg>`;
  return box;
}

const add = (parent, html) => { parent.insertAdjacentHTML('beforeend', html); return parent.lastElementChild; };
const legend = lines => `<div class="legend">${lines.map(l => `<span><i class="${l.dash ? 'dash' : ''}" style="border-color:${l.colour}"></i>${esc(l.name)}</span>`).join('')}</div>`;
function table(head, rows) {
  const cell = (tag, v) => `<${tag}${typeof v === 'number' || /^[-–\d]/.test(v) ? ' class="n"' : ''}>${Number.isInteger(v) ? v : typeof v === 'number' ? number(v) : v}</${tag}>`;
  return `<div class="scroll"><table><tr>${head.map((h, i) => `<th${rows.length && /^[-–\d]/.test(rows[0][i]) ? ' class="n"' : ''}>${h}</th>`).join('')}</tr>${rows.map(r => `<tr>${r.map(v => cell('td', v)).join('')}</tr>`).join('')}</table></div>`;
}
const facts = rows => table(['', ''], rows.map(([k, v]) => [words(k), esc(typeof v === 'object' ? JSON.stringify(v) : v)]));

const plain = name => String(name).replace(/_/g, ' ');
const SAID = {
  'first seen': () => 'the first record that the monitor got',
  late: e => `${e.deadline_to_torque_ns ? `the torque came ${duration(e.deadline_to_torque_ns)} after the deadline` : 'no torque came'}: ${CAUSE_WORDS[e.cause] ?? plain(e.cause)}`,
  missed: e => `${e.ticks === 1 ? 'no torque in time' : `${e.ticks} ticks without a torque in time`}${e.decision ? `, ${plain(e.decision)}` : ''}: ${CAUSE_WORDS[e.cause] ?? plain(e.cause)}`,
  gap: e => `${e.ticks === 1 ? '1 record' : `${e.ticks} records`} did not reach the monitor`,
  rejected: e => `a torque of controller ${e.controller} was not applied: ${plain(e.reason)}`,
  bound: e => `the bound was broken: ${WHY[e.verdict] ?? plain(e.verdict)}`,
  promise: e => `V = ${number(e.v)} is above its certified bound ${number(e.v_bound)}`,
  level: e => `V = ${number(e.v)} is ${e.inside ? 'within the level again' : 'above the level'}, c = ${number(e.level)}`,
};
function describe(event) {
  const { tick, t_s, kind, ...rest } = event;
  const text = rest.text ?? SAID[kind]?.(event);
  if (text) return `tick ${tick}: ${kind}, ${text}`;
  const parts = Object.entries(rest).filter(([, v]) => v !== null).map(([k, v]) => `${k.replace(/_/g, ' ')} ${k.endsWith('_ns') ? duration(v) : typeof v === 'number' ? number(v) : v}`);
  return `tick ${tick}: ${kind}${parts.length ? `, ${parts.join(', ')}` : ''}`;
}

// The law, with what its controller calls itself where that is something else.
function whose({ law, name }) {
  if (law) return name && name !== law ? `${law} (${name})` : law;
  return name ? `${name} (announced no law)` : 'no announced law';
}

// The parts of a page, each drawn for every run in a row of its own, so that two runs stay side by side.
function head(run, at) {
  const s = run.summary, status = s.verdict?.status ?? 'no data', reasons = s.verdict?.reasons ?? [];
  // Green beside a reason against it would contradict itself.
  const mood = run.mood === 'good' && reasons.length ? 'warn' : run.mood;
  add(at, `<div class="verdict"><span class="badge ${mood}">${esc(status)}</span><div><h1>${esc(run.name)}</h1><span class="note">${esc(s.written ?? '')} · ${esc(s.mode ?? '')} · ${esc(whose(s.bound ?? {}))} · loopbound ${esc(s.version ?? '')}</span></div></div>`);
  if (run.meaning) add(at, `<p class="note"><b>${esc(status)}</b>: ${esc(run.meaning.replace(/`/g, ''))}.</p>`);
  add(at, reasons.length ? `<ul class="reasons">${reasons.map(r => `<li>${esc(r)}</li>`).join('')}</ul>` : `<p class="note">${s.verdict?.expectations?.length ? 'Every expectation held. ' : ''}${s.bound?.violations_promise ? `V was above its certified bound in ${number(s.bound.violations_promise, 9)} ticks. ` : ''}Missed and late ticks are counted below, with their causes.</p>`);
  const trip = s.latency_ns?.round_trip ?? {}, b = s.bound ?? {};
  const tiles = [
    ['rate', `${number(s.rate_hz, 9)} Hz`], ['ticks seen', number(s.ticks_seen, 9)], ['missed', number(s.missed_ticks, 9), s.missed_ticks ? 'warn' : ''],
    ['late', number(s.late_ticks, 9), s.late_ticks ? 'warn' : ''], [s.latency_is_virtual ? 'round trip p50 (virtual)' : 'round trip p50', duration(trip.p50)],
    ['round trip p99', duration(trip.p99)], ['round trip p99.9', duration(trip.p99_9)], ['longest round trip', duration(trip.max)],
    ['largest |e<sub>i</sub>| of one link, settled', withUnit(s.tracking?.max_abs_e_rad, 'rad')], ['largest ‖e‖ of all links, settled', withUnit(s.tracking?.max_norm_e_rad, 'rad')],
    ['bound violated, ticks', number(b.violations, 9), b.violations > (b.verdicts?.designed_hold ?? 0) ? 'bad' : ''], ['least slack of the certified bound', withUnit(b.slack_min, b.v_unit)],
    [`latency budget used${b.budget_rule ? `, by the rule for a ${esc(b.budget_rule)}` : ''}`, b.budget_used === null || b.budget_used === undefined ? '–' : `${number(100 * b.budget_used, 3)} %`, b.budget_used >= 1 ? 'warn' : ''],
  ];
  add(at, `<div class="tiles">${tiles.map(([name, value, mood = '']) => `<div class="tile ${mood}"><b>${value}</b><span>${name}</span></div>`).join('')}</div>`);
  if (s.missed_ticks) add(at, `<p class="note">Round trips are those of the ticks that got a torque (${number(trip.n ?? 0, 9)}). A verdict counts each missed tick (${number(s.missed_ticks, 9)}) as longer than every limit, so its quantiles can be higher than these.</p>`);
  const expected = s.verdict?.expectations ?? [];
  if (expected.length) add(at, table(['expected', 'outcome', 'found'], expected.map(e => [esc(e.expectation), esc(e.outcome), esc(e.reason)])));
}
const marksOf = run => run.events.filter(e => e.kind in MARKED || (e.kind === 'missed' && e.cause === 'injected_fault'))
  .map(e => ({ t: e.t_s, colour: colour(MARKED[e.kind] ?? 5), text: describe(e) }));
const kinds = run => [...new Set(run.events.filter(e => e.kind in MARKED).map(e => e.kind))].map(kind => ({ name: kind, dash: true, colour: colour(MARKED[kind]) }));
const perLink = (run, group, name, more = {}) => Array.from({ length: run.summary.links ?? 0 }, (_, i) =>
  ({ name: `${name}${i + 1}`, at: group * run.summary.links + i, colour: colour(i), ...more }));

function tracking(run, at) {
  const lines = [...perLink(run, 1, 'wanted q', { dash: '5 4' }), ...perLink(run, 0, 'q')];
  add(at, legend([...lines, ...kinds(run)]));
  at.append(overTime(run, { unit: 'rad', lines, marks: marksOf(run), height: 230 }));
}
function errors(run, at) {
  const lines = perLink(run, 2, 'e');
  add(at, legend(lines));
  at.append(overTime(run, { unit: 'rad', lines, marks: marksOf(run) }));
}
function torques(run, at) {
  const lines = perLink(run, 3, 'τ');
  add(at, legend(lines));
  at.append(overTime(run, { unit: 'N·m', lines, marks: marksOf(run) }));
}
function bound(run, at) {
  const base = 4 * (run.summary.links ?? 0);
  const lines = [
    { name: 'c, the certified level', at: base + 2, colour: 'var(--bad)', dash: '8 4' },
    { name: 'certified bound, from the tick before', at: base + 1, colour: colour(1), dash: '4 3' },
    { name: 'V', at: base, colour: colour(0) },
  ];
  const broken = run.events.filter(e => e.kind === 'bound' || e.kind === 'promise');
  const t = run.series.t_s, high = run.series.high[base] ?? [];
  const vAt = time => { let k = t.findIndex(x => x > time); k = k < 0 ? t.length - 1 : k - 1; return high[Math.max(k, 0)] ?? null; };
  const dots = broken.map(e => ({ t: e.t_s, y: e.v ?? vAt(e.t_s) ?? 1, colour: e.verdict === 'designed_hold' ? colour(2) : 'var(--bad)', text: describe(e) }));
  add(at, legend(lines));
  at.append(overTime(run, { unit: `V${run.summary.bound?.v_unit ? ', ' + run.summary.bound.v_unit : ''} (log)`, lines, dots, marks: marksOf(run), yLog: true, height: 260 }));
  const laws = run.summary.bound?.laws ?? [];
  if (laws.length) add(at, table(['law', 'controllers', 'ticks', 'V max', 'c', 'bound broken', 'Ψ max', 'C1 (ctc: η0)', '‖W‖ settled', '‖W‖ certified', '‖e‖ of all links certified, rad', '|e_i| of each link certified, rad'], laws.map(l =>
    [esc(whose(l)), l.controllers.join(', '), l.ticks, withUnit(l.v_max, l.v_unit), withUnit(l.level, l.v_unit), `${l.violations} of ${l.checked}`, withUnit(l.psi_max, l.psi_unit), withUnit(l.c1, l.psi_unit), number(l.w_norm_max_settled), vanishing(l, l.uub_radius), vanishing(l, l.ultimate_bound), vanishing(l, l.ultimate_bound_link ?? l.ultimate_bound)])));
  if (broken.length) {
    const rows = broken.slice(0, 200).map(e => [e.tick, number(e.t_s, 9), e.kind === 'bound' ? words(e.verdict) : 'certified bound on V', e.kind === 'bound'
      ? `X = ${number(e.x)}, ∫L = ${number(e.int_l)}, ∫F = ${number(e.int_f)}: ${esc(WHY[e.verdict] ?? '')}` : `V = ${number(e.v)} is above its certified bound ${number(e.v_bound)}`]);
    add(at, table(['tick', 't, s', 'found', 'why'], rows));
  } else add(at, `<p class="note">${run.summary.bound?.certified ? 'V kept both bounds in every tick that was checked.' : 'Nothing is certified here: V is shown without bounds.'}</p>`);
}
function slack(run, at) {
  const b = run.summary.bound ?? {};
  if (b.slack_min == null) { add(at, '<p class="note">Nothing is certified here.</p>'); return; }
  const line = { name: 'certified bound − V', at: 4 * (run.summary.links ?? 0) + 4, colour: colour(2) };
  at.append(overTime(run, { unit: 'log', lines: [line], marks: marksOf(run), yLog: true, height: 160 }));
  const most = b.epsilon == null ? '' : `; ε h = ${withUnit(b.epsilon / run.summary.rate_hz, b.v_unit)} is what the worst uncertainty may add in a tick`;
  add(at, `<p class="note">Least ${withUnit(b.slack_min, b.v_unit)}, mean ${withUnit(b.slack_mean, b.v_unit)} a tick${most}.</p>`);
}
function latency(run, at) {
  add(at, legend(HOPS.map((hop, i) => ({ name: HOP_WORDS[hop], colour: colour(i) }))));
  at.append(percentileChart(run));
  const q = { ...run.summary.latency_ns, floor: run.summary.floor };
  add(at, table(['hop', 'n', 'p50', 'p90', 'p99', 'p99.9', 'max'], HOPS.filter(h => q[h]?.n).map(h => [esc(HOP_WORDS[h]), q[h].n, ...['p50', 'p90', 'p99', 'p99_9', 'max'].map(k => duration(q[h][k]))])));
}
function trips(run, at) {
  const line = { name: 'round trip, µs', at: 4 * (run.summary.links ?? 0) + 3, colour: colour(4) };
  at.append(overTime(run, { unit: 'µs (log)', lines: [line], marks: marksOf(run), yLog: true, height: 180 }));
}
function late(run, at) {
  const found = run.events.filter(e => e.kind === 'late' || e.kind === 'missed');
  const dots = found.map(e => ({ t: e.t_s, y: Math.max(e.deadline_to_torque_ns || e.magnitude_ns || 1, 1) / 1e3, colour: colour(CAUSES[e.cause] ?? 7), text: describe(e), stem: true }));
  const causes = [...new Set(found.map(e => e.cause))];
  if (!found.length) { add(at, '<div class="chart"><div class="empty">No tick was late or missed.</div></div>'); return; }
  add(at, legend(causes.map(c => ({ name: `${CAUSE_WORDS[c] ?? plain(c)} (${found.filter(e => e.cause === c).length})`, colour: colour(CAUSES[c] ?? 7) }))));
  at.append(overTime(run, { unit: 'µs (log)', lines: [], dots, marks: marksOf(run), yLog: true, height: 190 }));
}
function happened(run, at) {
  const left = run.events_left_out ? `<p class="note">${run.events_left_out} more in events.jsonl.</p>` : '';
  add(at, `<details open><summary>Events (${run.events.length})</summary>${table(['tick', 't, s', 'kind', 'what'], run.events.slice(0, 500).map(e => [e.tick, (e.t_s ?? 0).toFixed(6), words(e.kind), esc(describe(e).replace(/^tick \d+: [^,]*,? ?/, ''))]))}${left}</details>`);
}
function machine(run, at) {
  const s = run.summary;
  add(at, facts(Object.entries(s.host ?? {})));
  const rows = (s.processes ?? []).map(p => [`${esc(p.role)} ${p.id}`, esc(p.name), p.privileges?.priority ? `FIFO ${p.privileges.priority}, core ${p.privileges.core ?? 'any'}` : 'ordinary', (p.missing ?? []).map(m => `${esc(m.step)}: ${esc(m.cost)}; ${esc(m.remedy)}`).join('<br>') || 'nothing was refused']);
  add(at, table(['process', 'law', 'scheduling', 'refused'], rows));
  add(at, `<details><summary>Scenario</summary><pre>${esc(JSON.stringify(s.scenario ?? {}, null, 2))}</pre></details>`);
}

const page = document.getElementById('page');
page.textContent = '';
page.classList.toggle('pair', RUNS.length > 1);
function section(title, note, part) {
  if (title) add(page, `<h2>${title}</h2>`);
  if (note) add(page, `<p>${note}</p>`);
  const row = add(page, '<div class="runs"></div>');
  RUNS.forEach(run => part(run, add(row, '<div></div>')));
}
section('', '', head);
add(page, '<div class="bar">Drag across a chart to zoom all of them, Ctrl and wheel too, double click to see the whole. Shown: <span class="interval"></span> <button id="whole">whole run</button></div>');
document.getElementById('whole').addEventListener('click', () => show(WHOLE[0], WHOLE[1]));
section('Tracking', 'Angles of the links from the downward vertical; dashed: where they should be. Vertical dashes: swaps, failovers, faults.', tracking);
section('Tracking error', '', errors);
section('Torque', 'As it acted at the end of each tick.', torques);
section('V against its bounds', 'A certified loop that starts below c stays below it, and V falls at least as fast as certified, tick by tick. Red dots: a bound was broken.', bound);
section('Slack of the certified bound', 'How far below its certified bound V stayed in each tick: how conservative the bound is.', slack);
section('Latency, by hop', 'Log axes: each step to the right is one more nine.', latency);
section('Round trip over the run', '', trips);
section('Late and missed ticks, by cause', 'Height: from the deadline to the torque, or how long the delay was. Causes come from evidence, never from guesses.', late);
section('', '', happened);
section('Machine and processes', '', machine);
show(WHOLE[0], WHOLE[1]);
