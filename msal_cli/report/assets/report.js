// The table of all files: sorted, filtered and shown in parts, so that ten thousand rows stay quick.
// Whatever comes from outside is put in as text, never as markup.
"use strict";
(() => {
  const ROWS_AT_ONCE = 50;
  const data = (id) => JSON.parse(document.getElementById(id).textContent);
  const columns = data("columns"), rows = data("rows"), pictures = data("pictures");
  const VIEWS = ["Before", "After", "Deviation"];
  const KINDS = [["failed", "Failed"], ["gate", "Gate broken"], ["planned", "Not done"], ["good", "Well"]];
  const at = (id) => document.getElementById(id);
  const body = document.querySelector("#files tbody");
  const collator = new Intl.Collator("en", { numeric: true });
  const words = rows.map((row) => [row.values[0], row.values[1], ...row.details.flat()].join("\n").toLowerCase());
  const state = { column: -1, sign: 1, kind: "", find: "", first: 0, open: new Set() };
  let order = [];

  function element(name, attributes = {}, ...inner) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...inner);
    return made;
  }

  // --- what is shown, in which order

  function settle() {
    const parts = state.find.toLowerCase().split(/\s+/).filter(Boolean);
    order = [];
    for (let k = 0; k < rows.length; k++)
      if ((!state.kind || rows[k].kind === state.kind) && parts.every((part) => words[k].includes(part))) order.push(k);
    if (state.column >= 0) order.sort(compared);
    state.first = Math.min(state.first, Math.max(0, order.length - 1));
    state.first -= state.first % ROWS_AT_ONCE;
  }

  // What is not known comes last, whichever way; equals stay worst first.
  function compared(k, l) {
    const one = rows[k].values[state.column], other = rows[l].values[state.column];
    if (one === null || other === null) return (one === null) - (other === null) || k - l;
    const step = typeof one === "number" ? one - other : collator.compare(one, other);
    return state.sign * step || k - l;
  }

  function figure(value, column) {
    if (value === null) return "";
    if (Number.isInteger(value) && !column.unit) return value.toLocaleString("en");
    if (column.unit === "%") return `${value > 0 ? "+" : ""}${value.toPrecision(3)}`.replace("-", "−");
    if (column.unit === "faces") return value.toLocaleString("en");
    if (column.unit === "s") return value.toFixed(2);
    if (!value) return "0";
    return Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(value >= 1000 ? 5 : 3)));
  }

  function picture(text, alt, size) {
    const made = element("img", { alt, ...size });
    made.src = `data:image/jpeg;base64,${text}`;
    return made;
  }

  // What a narrow screen shows before a figure, where there are no heads.
  const label = ({ title, unit }) => (unit ? `${title}, ${unit}` : title);

  function line(k) {
    const row = rows[k];
    const made = element("tr", { class: row.kind });
    if (pictures) {
      const views = element("td", { class: "views" });
      (pictures[k] || []).forEach((text, view) => text && views.append(picture(text, VIEWS[view], { width: 64, height: 48 })));
      made.append(views);
    }
    columns.forEach((column, at) => {
      const value = row.values[at];
      if (column.kind === "name") {
        const open = element("button", { type: "button", class: "open", "aria-expanded": state.open.has(k) }, value);
        open.addEventListener("click", () => toggle(k, made, open));
        made.append(element("th", { scope: "row" }, open));
      } else if (row.kind === "failed" && column.kind === "figure") {
        // Instead of figures that there are none of.
        if (columns[at - 1].kind !== "figure") made.append(element("td", { class: "why", colspan: columns.length - at }, row.details[0][1]));
      } else if (column.kind === "figure") made.append(element("td", { class: "figure", "data-title": label(column) }, figure(value, column)));
      else {
        // A word that the details explain, such as what was chosen, tells why where one points at it.
        const why = row.details.find(([word]) => word === column.title);
        made.append(element("td", { class: "status", ...(why && { title: why[1] }) }, value));
      }
    });
    return made;
  }

  function details(k) {
    const inner = element("td", { colspan: columns.length + (pictures ? 1 : 0) });
    const views = (pictures && pictures[k]) || [];
    if (views.some(Boolean)) {
      const large = element("div", { class: "large" });
      views.forEach((text, view) => text && large.append(element("figure", {}, picture(text, `${VIEWS[view]}: ${rows[k].values[0]}`, {}), element("figcaption", {}, VIEWS[view]))));
      inner.append(large);
    }
    const list = element("dl");
    for (const [word, text] of rows[k].details) list.append(element("dt", {}, word), element("dd", {}, text));
    inner.append(list);
    return element("tr", { class: "more" }, inner);
  }

  function toggle(k, row, button) {
    const isOpen = !state.open.has(k);
    button.setAttribute("aria-expanded", isOpen);
    if (isOpen) {
      state.open.add(k);
      row.after(details(k));
    } else {
      state.open.delete(k);
      row.nextElementSibling.remove();
    }
  }

  function show() {
    settle();
    const last = Math.min(order.length, state.first + ROWS_AT_ONCE);
    const lines = [];
    for (const k of order.slice(state.first, last)) {
      lines.push(line(k));
      if (state.open.has(k)) lines.push(details(k));
    }
    body.replaceChildren(...lines);
    const number = (value) => value.toLocaleString("en");
    at("count").textContent = order.length ? `${number(state.first + 1)}–${number(last)} of ${number(order.length)}` : "no file matches";
    at("back").disabled = state.first === 0;
    at("on").disabled = last === order.length;
    at("worst").setAttribute("aria-pressed", state.column < 0);
    [...heads.children].forEach((head) => {
      const isChosen = Number(head.dataset.column) === state.column;
      if (isChosen) head.setAttribute("aria-sort", state.sign > 0 ? "ascending" : "descending");
      else head.removeAttribute("aria-sort");
    });
  }

  // --- what can be asked

  function sortBy(column) {
    if (state.column === column) state.sign = -state.sign;
    // Of figures the large ones are looked for.
    else [state.column, state.sign] = [column, columns[column].kind === "figure" ? -1 : 1];
    state.first = 0;
    show();
  }

  const heads = document.querySelector("#files thead tr");
  [...heads.children].forEach((head, column) => {
    const button = element("button", { type: "button" }, ...head.childNodes);
    button.addEventListener("click", () => sortBy(column));
    head.replaceChildren(button);
    head.classList.add("live");
    head.dataset.column = column;
  });
  if (pictures) heads.prepend(element("th", { scope: "col" }, "Before, after,", element("small", {}, "deviation")));

  const choose = (kind) => {
    Object.assign(state, { kind, first: 0 });
    for (const one of at("choices").children) one.setAttribute("aria-pressed", one.dataset.kind === kind);
    show();
  };
  const counts = KINDS.map(([kind, word]) => [kind, word, rows.filter((row) => row.kind === kind).length]).filter((one) => one[2]);
  if (counts.length > 1)
    for (const [kind, word, count] of [["", "All", rows.length], ...counts]) {
      const button = element("button", { type: "button", "data-kind": kind, "aria-pressed": kind === "" }, `${word} ${count.toLocaleString("en")}`);
      button.addEventListener("click", () => choose(kind));
      at("choices").append(button);
    }

  at("find").addEventListener("input", (event) => {
    Object.assign(state, { find: event.target.value, first: 0 });
    show();
  });
  at("worst").addEventListener("click", () => {
    Object.assign(state, { column: -1, first: 0 });
    show();
  });
  const turn = (step) => {
    state.first = Math.max(0, state.first + step * ROWS_AT_ONCE);
    show();
  };
  at("back").addEventListener("click", () => turn(-1));
  at("on").addEventListener("click", () => turn(1));
  at("tools").hidden = rows.length < 2;
  show();

  // --- histograms: how a figure is spread over the files

  const BINS = 16;
  const BEYOND = 0.02; // share of the values beyond each end, so that a few do not squeeze all others

  function histogram(title, note, name, unit) {
    const at = columns.findIndex((column) => column.title === name && column.unit === unit);
    const values = rows.map((row) => row.values[at] ?? null).filter((value) => value !== null).sort((a, b) => a - b);
    if (!values.length) return [];
    const beyond = Math.round(BEYOND * (values.length - 1));
    let [low, high] = [values[beyond], values[values.length - 1 - beyond]];
    if (low === high) [low, high] = [-1, 1].map((sign) => low + sign * (Math.abs(low) / 20 || 0.5));
    const edges = Array.from({ length: BINS + 1 }, (_, k) => low * (1 - k / BINS) + high * (k / BINS));
    const counts = new Array(BINS + 2).fill(0);
    for (const value of values) counts[value > high ? BINS + 1 : edges.filter((edge, k) => k < BINS && edge <= value).length]++;
    const most = Math.max(...counts);
    const text = (value) => figure(value, columns[at]) + (unit === "%" ? " %" : "");
    const places = [`below ${text(low)}`, ...edges.slice(1).map((edge, k) => `${text(edges[k])} to ${text(edge)}`), `above ${text(high)}`];
    const bars = counts.map((count, k) => {
      const bar = element("i", { class: k % (BINS + 1) ? "bar" : "out", title: `${count.toLocaleString("en")} of ${values.length.toLocaleString("en")} files, ${places[k]}` });
      bar.style.height = count ? `max(2px, ${(100 * count) / most}%)` : "0";
      return bar;
    });
    const label = `${title}: from ${text(values[0])} to ${text(values[values.length - 1])}, median ${text(values[values.length >> 1])}`;
    const caption = element("figcaption", {}, element("b", {}, title), " ", element("span", {}, `${note}; tallest bar: ${most.toLocaleString("en")}`));
    const ends = [low, edges[BINS / 2], high].map((value) => element("span", {}, text(value)));
    return [element("figure", { class: "histogram" }, caption, element("div", { class: "bars", role: "img", "aria-label": label }, ...bars), element("div", {}, ...ends))];
  }

  if (rows.length > 1)
    at("histograms").append(
      ...histogram("Volume change", "closed files", "Volume", "%"),
      ...histogram("Largest displacement", "mean edge lengths", "Max move", "edges"),
      ...histogram("Time for a file", "seconds", "Time", "s"),
    );
})();
