// The viewer: panes side by side, buttons, keys, scale bar and colour scale. Every element with data-viewer="FILE" becomes one.

import { Matrix4 } from "three";
import { gradient } from "./colors.js";
import { decoded, load } from "./load.js";
import { axes, cameras, points } from "./overlays.js";
import { MODES } from "./solid.js";
import { Stage } from "./stage.js";

const SCENES = { su_l: "plain ground", su_h: "textured ground", se: "no ground", su_b: "printed board", video: "photos" };
const OVERLAYS = ["axes", "cameras", "points"];
const STEP = Math.PI / 18;

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

class Viewer {
  constructor(root, manifest, base) {
    Object.assign(this, { root, manifest, base, mode: "textured", shown: new Set(["axes"]) });
    this.run = manifest.runs[0] ?? { key: "truth", panes: [] };
    root.replaceChildren(this.#bar(), this.#view());
    root.addEventListener("keydown", (event) => this.#key(event));
    this.stage = new Stage(this.canvas, () => this.#afterDrawing());
    this.ended = new AbortController();
    const { signal } = this.ended;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.stage.draw(), { signal });
    document.addEventListener("zeroshop-theme", () => this.stage.draw(), { signal });
  }

  /** Take it off the page for good. */
  dispose() {
    this.ended.abort();
    this.stage.dispose();
    this.root.remove();
  }

  #bar() {
    const bar = element("div", { className: "viewer-bar" });
    if (this.manifest.runs.length > 1) {
      const choice = element("select", { ariaLabel: "Which pictures and cameras" });
      for (const run of this.manifest.runs) {
        choice.append(element("option", { value: run.key }, `${SCENES[run.scene] ?? run.scene} (${run.scene}), ${run.registration}`));
      }
      choice.onchange = () => this.show(this.manifest.runs.find((run) => run.key === choice.value));
      this.choice = choice;
      bar.append(choice);
    }
    this.modeButtons = MODES.map((mode, k) => {
      const button = element("button", { type: "button", title: `${mode} (key ${k + 1})` }, mode);
      button.onclick = () => this.setMode(mode);
      return button;
    });
    bar.append(element("div", { className: "buttons", role: "group", ariaLabel: "Drawn as" }, ...this.modeButtons));
    this.overlayButtons = OVERLAYS.map((name) => {
      const button = element("button", { type: "button", title: `${name} (key ${name[0]})` }, name);
      button.onclick = () => this.toggle(name);
      return button;
    });
    bar.append(element("div", { className: "buttons", role: "group", ariaLabel: "Shown beside" }, ...this.overlayButtons));
    const home = element("button", { type: "button", title: "back to the start (key r)" }, "reset");
    home.onclick = () => this.stage.reset();
    bar.append(home);
    return bar;
  }

  #view() {
    this.canvas = element("canvas", { ariaLabel: "Meshes in 3D: drag to turn, scroll to zoom, right button to shift. Arrow keys turn, + and - zoom.", role: "img" });
    this.panes = element("div", { className: "panes" });
    this.scale = element("div", { className: "scale" }, element("span"));
    this.legend = element("div", { className: "legend", hidden: true });
    const view = element("div", { className: "viewer-view", tabIndex: 0 }, this.canvas, this.panes, this.scale, this.legend);
    view.setAttribute("aria-label", "3D view. Arrow keys turn, plus and minus zoom, 1 to 4 choose how it is drawn, r resets.");
    return view;
  }

  /** Load the meshes of a run and show them beside the truth. */
  async show(run) {
    this.run = run;
    this.root.setAttribute("aria-busy", "true");
    const wanted = [...run.panes];
    if (this.manifest.truth) wanted.push({ title: "true model", file: this.manifest.truth, matrix: run.panes[0]?.object_from_truth });
    const data = await Promise.all(wanted.map((pane) => load(this.base + pane.file)));
    this.scene = run.scene_file ? await load(this.base + run.scene_file) : null;
    if (this.run !== run || this.ended.signal.aborted) return;
    const elements = wanted.map((pane, k) => {
      const faces = (data[k].original_faces ?? 0).toLocaleString("en").replaceAll(",", "\u202f");
      return element("div", { className: "pane" }, element("strong", {}, pane.title), element("span", {}, `${faces} faces`));
    });
    this.panes.replaceChildren(...elements);
    this.panes.parentElement.style.setProperty("--panes", wanted.length);
    this.stage.setPanes(wanted.map((pane, k) => ({ data: data[k], matrix: pane.matrix, sceneMatrix: pane.object_from_scene, element: elements[k] })));
    this.limit_mm = data[0].limit_mm;
    if (this.manifest.truth && data[0].truth_distances) this.stage.panes.at(-1).solid.setDistances(decoded(data[0].truth_distances, Uint8Array));
    this.unit = run.panes.length && !run.panes[0].known_scale ? "units" : "mm";
    this.modeButtons[MODES.indexOf("distance")].disabled = !this.limit_mm;
    OVERLAYS.slice(1).forEach((name, k) => (this.overlayButtons[k + 1].disabled = !this.scene));
    this.setMode(this.mode === "distance" && !this.limit_mm ? "textured" : this.mode);
    this.stage.resize();
    this.stage.frame();
    this.#overlay();
    this.root.removeAttribute("aria-busy");
    this.root.dataset.ready = run.key;
  }

  setMode(mode) {
    this.mode = mode;
    this.modeButtons.forEach((button, k) => button.setAttribute("aria-pressed", MODES[k] === mode));
    this.stage.panes.forEach(({ solid }) => solid.show(mode));
    this.legend.hidden = mode !== "distance";
    if (mode === "distance") this.#drawLegend();
    this.stage.draw();
  }

  #drawLegend() {
    const ramp = element("i");
    ramp.style.background = gradient();
    const text = "distance to the true surface; grey: no photo shows it";
    this.legend.replaceChildren(element("span", {}, "0"), ramp, element("span", {}, `≥ ${this.limit_mm.toPrecision(2)} mm`), element("small", {}, text));
  }

  toggle(name) {
    this.shown.has(name) ? this.shown.delete(name) : this.shown.add(name);
    this.#overlay();
  }

  #overlay() {
    this.overlayButtons.forEach((button, k) => button.setAttribute("aria-pressed", this.shown.has(OVERLAYS[k])));
    const size = this.stage.radius;
    for (const pane of this.stage.panes) {
      pane.scene.remove(...pane.overlays);
      pane.overlays = [];
      if (this.shown.has("axes")) pane.overlays.push(axes(this.stage.half, size * 0.25));
      const found = [];
      if (this.shown.has("cameras") && this.scene) found.push(cameras(this.scene, size * 0.35));
      if (this.shown.has("points") && this.scene) found.push(points(this.scene, size * 0.02));
      if (pane.sceneMatrix) found.forEach((overlay) => overlay.applyMatrix4(new Matrix4().set(...pane.sceneMatrix.flat())));
      pane.overlays.push(...found);
      if (pane.overlays.length) pane.scene.add(...pane.overlays);
    }
    this.stage.draw();
  }

  #afterDrawing() {
    const perUnit = this.stage.pixelsPerUnit();
    const wanted = 150 / perUnit;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map((step) => step * power).find((step) => step <= wanted) ?? power;
    this.scale.firstChild.style.width = `${length * perUnit}px`;
    this.scale.firstChild.textContent = `${Number(length.toPrecision(2))} ${this.unit ?? "mm"}`;
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || ["SELECT", "INPUT"].includes(event.target.tagName)) return;
    const turns = { ArrowLeft: [-STEP, 0, 1], ArrowRight: [STEP, 0, 1], ArrowUp: [0, STEP, 1], ArrowDown: [0, -STEP, 1], "+": [0, 0, 1.15], "=": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
    const overlay = OVERLAYS.find((name) => name[0] === event.key);
    const mode = MODES[Number(event.key) - 1];
    if (turns[event.key]) this.stage.move(...turns[event.key]);
    else if (mode && !this.modeButtons[MODES.indexOf(mode)].disabled) this.setMode(mode);
    else if (overlay) this.toggle(overlay);
    else if (event.key === "r") this.stage.reset();
    else return;
    event.preventDefault();
  }
}

/** Turn an element into a viewer of the meshes that `file` lists. */
export async function mount(root, file) {
  const base = file.slice(0, file.lastIndexOf("/") + 1);
  try {
    const manifest = await load(file);
    const viewer = new Viewer(root, manifest, base);
    await viewer.show(viewer.run);
    return viewer;
  } catch (error) {
    root.dataset.failed = error.message;
    root.replaceChildren(element("p", { className: "note" }, `The 3D view cannot be shown (${error.message}). It needs WebGL 2, which every current browser has when graphics are not switched off.`));
    return null;
  }
}

window.zeroshop.mount = mount;
document.querySelectorAll("[data-viewer]").forEach((root) => mount(root, root.dataset.viewer));
