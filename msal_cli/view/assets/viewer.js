// The viewer: one for each element of class msal-scene, with the picture in it until it starts.

const TURN = Math.PI / 24; // by one press of an arrow key

function element(name, attributes = {}, ...inner) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...inner);
  return made;
}

class Viewer {
  constructor(box, scene) {
    this.box = box;
    this.scene = scene;
    this.unit = placed(scene);
    this.camera = new Camera(scene.header.view, scene.meshes.map((mesh) => mesh.positions));
    this.look = { split: 0.5, isFlat: false, isMapped: false, isPainted: true, turn: 2.2, clay: [0.83, 0.79, 0.73] };
    this.isPair = scene.meshes.length > 1;
    this.fingers = new Map();
    this.build();
    this.drawing = new Drawing(this.canvas, scene, this.camera.start);
    for (const mesh of scene.meshes) mesh.positions = mesh.normals = mesh.corners = mesh.colours = null;
    this.listen();
    if (box.dataset.shading === "flat") this.flat(true);
    this.resize();
  }

  // --- what is seen beside the picture

  build() {
    const before = "Before", after = "After";
    this.canvas = element("canvas", {
      tabindex: 0,
      role: "application",
      "aria-label": `3D view${this.isPair ? `, ${before} left and ${after} right` : ""}. Arrow keys turn, shift and arrow keys move, plus and minus zoom, 0 starts anew.`,
    });
    this.stage = element("div", { class: "msal-stage" }, this.canvas);
    this.bar = element("div", { class: "msal-bar", role: "toolbar", "aria-label": "View" });
    if (this.isPair) this.buildSlider(before, after);
    if (this.scene.deviation) {
      const words = this.isPair ? [after, "Deviation"] : ["Surface", "Deviation"];
      this.bar.append((this.maps = this.choice(this.isPair ? "Right side" : "Colour", words, (k) => this.map(k === 1))));
      this.stage.append((this.legend = this.scale(this.scene.header.deviation)));
    }
    if (this.scene.meshes.some((mesh) => mesh.colours))
      this.bar.append((this.paints = this.choice("Paint", ["Colours", "Clay"], (k) => this.paint(k === 0))));
    this.bar.append((this.facets = this.choice("Shading", ["Smooth", "Facets"], (k) => this.flat(k === 1))));
    const light = element("input", { type: "range", min: 0, max: 360, step: 5, value: 126, "aria-label": "Where the light comes from, degrees" });
    light.addEventListener("input", () => this.set({ turn: (light.value * Math.PI) / 180 }));
    this.light = light;
    this.bar.append(element("label", { class: "msal-light" }, "Light", light));
    this.bar.append(this.button("Reset", "Start view (0)", () => this.reset()));
    if (document.fullscreenEnabled)
      this.bar.append(this.button("Full screen", "Full screen", () => (document.fullscreenElement ? document.exitFullscreen() : this.box.requestFullscreen())));
    this.ruler = element("div", { class: "msal-ruler", "aria-hidden": "true" }, element("span"));
    this.stage.append(this.ruler);
    this.box.append(this.stage, this.bar);
    this.box.classList.add("msal-live");
  }

  buildSlider(before, after) {
    this.slider = element("div", {
      class: "msal-split",
      role: "slider",
      tabindex: 0,
      "aria-orientation": "horizontal",
      "aria-valuemin": 0,
      "aria-valuemax": 100,
      "aria-label": `Share of the picture that shows ${before}`,
    }, element("i"));
    this.names = [element("span", { class: "msal-name msal-left" }, before), element("span", { class: "msal-name msal-right" }, after)];
    this.afterName = after;
    this.stage.append(...this.names, this.slider);
  }

  button(text, title, act) {
    const made = element("button", { type: "button", title }, text);
    made.addEventListener("click", act);
    return made;
  }

  choice(label, words, act) {
    const group = element("span", { class: "msal-choice", role: "group", "aria-label": label });
    words.forEach((word, k) => group.append(this.button(word, `${label}: ${word}`, () => act(k))));
    group.choose = (chosen) => [...group.children].forEach((one, k) => one.setAttribute("aria-pressed", k === chosen));
    group.choose(0);
    return group;
  }

  // A ruler of colours with its ends, in file units.
  scale({ low, high, least, most, colours }) {
    const table = Uint8Array.from(atob(colours), (one) => one.charCodeAt(0));
    const last = table.length / 3 - 1;
    const stops = [];
    for (let k = 0; k <= 16; k++) stops.push(`rgb(${table.slice(3 * Math.round((k * last) / 16), 3 * Math.round((k * last) / 16) + 3).join(",")})`);
    const strip = element("div", { class: "msal-strip" });
    strip.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    const ticks = element("div", { class: "msal-ticks" });
    const rank = Math.floor(Math.log10(high));
    const ten = rank < -3 || rank > 4 ? 10 ** rank : 1;
    const said = (value) => short(value / ten, (high - low) / ten);
    for (let k = 0; k <= 4; k++) {
      const beyond = (k === 0 && least < low) || (k === 4 && most > high);
      ticks.append(element("span", {}, `${beyond ? (k ? "≥ " : "≤ ") : ""}${said(low + ((high - low) * k) / 4)}`));
    }
    const unit = ten === 1 ? "file units" : `10${raised(rank)} file units`;
    const head = element("div", {}, element("b", {}, this.box.dataset.deviation || "Deviation"), " ", element("small", {}, unit));
    const legend = element("div", { class: "msal-legend" }, head, strip, ticks);
    const note = this.box.dataset.note ? `; ${this.box.dataset.note}` : "";
    legend.append(element("small", {}, `${said(least)} to ${said(most)} in all${note}`));
    legend.hidden = true;
    return legend;
  }

  // --- what can be changed

  set(change) {
    Object.assign(this.look, change);
    this.redraw();
  }

  flat(isFlat) {
    this.facets.choose(isFlat ? 1 : 0);
    this.set({ isFlat });
  }

  paint(isPainted) {
    if (!this.paints) return;
    this.paints.choose(isPainted ? 0 : 1);
    this.set({ isPainted });
  }

  map(isMapped) {
    if (!this.maps) return;
    this.maps.choose(isMapped ? 1 : 0);
    this.legend.hidden = !isMapped;
    if (this.names) this.names[1].textContent = isMapped ? "Deviation" : this.afterName;
    this.set({ isMapped });
  }

  split(share) {
    if (this.isPair) this.set({ split: Math.min(1, Math.max(0, share)) });
  }

  reset() {
    this.camera.reset();
    this.camera.fit(this.aspect);
    this.light.value = 126;
    this.set({ turn: 2.2, split: 0.5 });
  }

  redraw() {
    if (this.waits) return;
    this.waits = true;
    requestAnimationFrame(() => {
      this.waits = false;
      this.drawing.draw(this.camera, this.look);
      this.measure();
      if (!this.slider) return;
      const percent = 100 * this.look.split;
      this.slider.style.left = `${percent}%`;
      this.slider.setAttribute("aria-valuenow", Math.round(percent));
      this.slider.setAttribute("aria-valuetext", `${Math.round(percent)} % before, ${Math.round(100 - percent)} % after`);
      this.names[0].style.opacity = percent < 4 ? 0 : 1;
      this.names[1].style.opacity = percent > 96 ? 0 : 1;
    });
  }

  // A bar of a round length, as it is in the middle of the picture.
  measure() {
    const pixel = (2 * FIELD * this.camera.distance * this.unit) / this.canvas.clientHeight;
    const most = 0.22 * this.canvas.clientWidth * pixel;
    const ten = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].find((one) => one * ten <= most) * ten;
    this.ruler.style.width = `${length / pixel}px`;
    this.ruler.firstChild.textContent = short(length, length);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const fine = Math.min(2, devicePixelRatio || 1);
    this.canvas.width = Math.round(width * fine);
    this.canvas.height = Math.round(height * fine);
    const before = this.aspect;
    this.aspect = width / height;
    if (!this.camera.distance) this.camera.fit(this.aspect);
    else if (before) this.camera.distance *= Math.min(1, before) / Math.min(1, this.aspect);
    this.redraw();
  }

  // --- mouse, touch, keys

  listen() {
    const canvas = this.canvas;
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => start(this.box));
    this.box.addEventListener("keydown", (event) => this.key(event));
    if (!this.slider) return;
    const follow = (event) => {
      const area = this.stage.getBoundingClientRect();
      this.split((event.clientX - area.left) / area.width);
    };
    this.slider.addEventListener("pointerdown", (event) => {
      this.slider.setPointerCapture(event.pointerId);
      this.slider.addEventListener("pointermove", follow);
      this.slider.focus({ preventScroll: true });
    });
    for (const name of ["pointerup", "pointercancel"]) this.slider.addEventListener(name, () => this.slider.removeEventListener("pointermove", follow));
    this.slider.addEventListener("keydown", (event) => this.slide(event));
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.focus({ preventScroll: true });
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    event.preventDefault();
  }

  move(event) {
    const was = this.fingers.get(event.pointerId);
    if (!was) return;
    const now = [event.clientX, event.clientY];
    const height = this.canvas.clientHeight;
    const [right, down] = [(now[0] - was[0]) / height, (now[1] - was[1]) / height];
    const other = [...this.fingers].find(([id]) => id !== event.pointerId);
    if (other) {
      const [x, y] = other[1];
      const from = [was[0] - x, was[1] - y], to = [now[0] - x, now[1] - y];
      this.camera.zoom(Math.hypot(...to) / (Math.hypot(...from) || 1));
      this.camera.pan(right / 2, -down / 2);
      this.camera.turn(0, 0, Math.atan2(from[1] * to[0] - from[0] * to[1], from[0] * to[0] + from[1] * to[1]));
    } else if (event.shiftKey || event.buttons & 6) this.camera.pan(right, -down);
    else this.camera.turn(4 * right, 4 * down);
    this.fingers.set(event.pointerId, now);
    this.redraw();
  }

  wheel(event) {
    // A page that is scrolled past several scenes must not be caught by one.
    if (this.box.dataset.start === "click" && document.activeElement !== this.canvas) return;
    event.preventDefault();
    const area = this.canvas.getBoundingClientRect();
    const lines = event.deltaMode ? 30 : 1;
    const right = (event.clientX - area.left - area.width / 2) / area.height;
    const up = (area.top + area.height / 2 - event.clientY) / area.height;
    this.camera.zoom(Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0016)), right, up);
    this.redraw();
  }

  slide(event) {
    const steps = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 };
    if (!(event.key in steps) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    this.split(this.look.split + steps[event.key]);
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target === this.light) return;
    const far = event.shiftKey;
    const arrow = (x, y) => () => (far ? this.camera.pan(x / 20, y / 20) : this.camera.turn(x * TURN, -y * TURN));
    const acts = {
      ArrowLeft: arrow(-1, 0), ArrowRight: arrow(1, 0), ArrowUp: arrow(0, 1), ArrowDown: arrow(0, -1),
      "+": () => this.camera.zoom(1.15), "=": () => this.camera.zoom(1.15),
      "-": () => this.camera.zoom(1 / 1.15), "_": () => this.camera.zoom(1 / 1.15),
      ",": () => this.camera.turn(0, 0, TURN), ".": () => this.camera.turn(0, 0, -TURN),
      "[": () => this.split(this.look.split - 0.02), "]": () => this.split(this.look.split + 0.02),
      1: () => this.split(1), 2: () => this.split(0.5), 3: () => this.split(0),
      d: () => this.map(!this.look.isMapped), f: () => this.flat(!this.look.isFlat), c: () => this.paint(!this.look.isPainted),
      l: () => this.relight(15), L: () => this.relight(-15),
      0: () => this.reset(), Home: () => this.reset(),
    };
    const act = acts[event.key] || acts[event.key.toLowerCase()];
    if (!act) return;
    event.preventDefault();
    act();
    this.redraw();
  }

  relight(degrees) {
    this.light.value = (Number(this.light.value) + degrees + 360) % 360;
    this.set({ turn: (this.light.value * Math.PI) / 180 });
  }
}

const raised = (rank) => String(rank).replace("-", "⁻").replace(/\d/g, (one) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[one]);

// A number with the digits that a scale of this span needs.
function short(value, span) {
  if (!value) return "0";
  const size = Math.abs(span);
  if (size >= 1e6 || size < 1e-4) {
    const [digits, rank] = value.toExponential(2).split("e");
    return `${Number(digits)}·10${raised(Number(rank))}`.replace("-", "−");
  }
  const text = value.toFixed(Math.max(0, Math.min(8, 3 - Math.floor(Math.log10(size)))));
  return text.replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "").replace("-", "−");
}

async function start(box) {
  box.querySelector(".msal-open")?.remove();
  box.querySelector(".msal-stage")?.remove();
  box.querySelector(".msal-bar")?.remove();
  box.dataset.state = "starting";
  try {
    if (!document.createElement("canvas").getContext("webgl2")) throw new Error("no WebGL2");
    const viewer = new Viewer(box, await unpacked(document.getElementById(box.dataset.scene).textContent));
    box.dataset.state = "ready";
    if (box.dataset.start === "click") viewer.canvas.focus({ preventScroll: true });
  } catch (error) {
    box.querySelector(".msal-stage")?.remove();
    box.querySelector(".msal-bar")?.remove();
    box.classList.remove("msal-live");
    box.dataset.state = "still";
    const reason = error.message === "no WebGL2" ? "This browser offers no WebGL, which the 3D view needs" : `The 3D view did not start (${error.message})`;
    const has = box.querySelector("img") ? ": here is a picture instead." : ".";
    box.append(element("p", { class: "msal-why", role: "status" }, reason + has));
  }
}

for (const box of document.querySelectorAll(".msal-scene")) {
  if (box.dataset.start !== "click") start(box);
  else {
    const open = element("button", { type: "button", class: "msal-open" }, "Open in 3D");
    open.addEventListener("click", () => start(box));
    box.append(open);
    box.dataset.state = "waiting";
  }
}
