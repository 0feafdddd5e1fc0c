// One canvas with a pane for each mesh; all panes are seen through one camera, so that they turn together.

import { AmbientLight, Box3, Color, DirectionalLight, Matrix4, PerspectiveCamera, Scene, Spherical, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Solid } from "./solid.js";

const FIELD_OF_VIEW_DEG = 30;
const START = new Vector3(1, -0.55, 0.45); // x towards the viewer, a little from the side and from above

export class Stage {
  /** @param canvas where to draw; @param drawn called after every drawing. */
  constructor(canvas, drawn) {
    this.canvas = canvas;
    this.drawn = drawn;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setScissorTest(true);
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 0.1, 1e5);
    this.camera.up.set(0, 0, 1);
    this.light = new DirectionalLight(0xffffff, 2.4);
    this.panes = [];
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(canvas);
  }

  /** Show these meshes: [{data, matrix, element}]; `element` is the part of the page that the pane covers. */
  setPanes(panes) {
    this.#freePanes();
    this.panes = panes.map(({ data, matrix, sceneMatrix, element }) => {
      const scene = new Scene();
      const solid = new Solid(data, () => this.draw());
      if (matrix) {
        solid.group.matrixAutoUpdate = false;
        solid.group.matrix.copy(new Matrix4().set(...matrix.flat()));
      }
      scene.add(solid.group, new AmbientLight(0xffffff, 1.1));
      return { scene, solid, element, sceneMatrix, overlays: [] };
    });
  }

  #freePanes() {
    this.panes.forEach((pane) => pane.solid.dispose());
  }

  /** Give back what the graphics card holds: browsers keep few WebGL contexts. */
  dispose() {
    cancelAnimationFrame(this.waiting);
    this.waiting = true;
    this.resizing.disconnect();
    this.controls.dispose();
    this.#freePanes();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** Put the camera where all of every mesh is seen, from the front and a little from above. */
  frame() {
    const box = new Box3();
    this.panes.forEach(({ solid }) => box.union(new Box3().setFromObject(solid.group)));
    const size = box.getSize(new Vector3());
    this.radius = Math.max(size.length() / 2, 1e-6);
    this.half = size.clone().multiplyScalar(0.5);
    this.centre = box.getCenter(new Vector3());
    this.reset();
  }

  reset() {
    const distance = this.#distanceToSeeAll() * 1.06;
    this.camera.near = distance / 100;
    this.camera.far = distance * 30;
    this.controls.target.copy(this.centre);
    this.camera.position.copy(START).normalize().multiplyScalar(distance).add(this.centre);
    this.controls.update();
    this.draw();
  }

  /** How far away along START every corner of the box is inside the pane, and stays so while turning about z. */
  #distanceToSeeAll() {
    const back = START.clone().normalize();
    const up = new Vector3(0, 0, 1).addScaledVector(back, -back.z).normalize();
    const tangent = Math.tan(((FIELD_OF_VIEW_DEG / 2) * Math.PI) / 180);
    const half = this.half;
    const wide = Math.hypot(half.x, half.y); // the box turned to its widest
    const near = wide * Math.hypot(back.x, back.y) + half.z * back.z;
    const high = half.z * up.z + wide * Math.hypot(up.x, up.y) + this.radius * 0.2; // room for the axes
    return near * 0.5 + Math.max(high / tangent, wide / (tangent * Math.max(this.aspect(), 0.1)));
  }

  /** Turn by angles in radians and come nearer by a factor. */
  move(azimuth, elevation, factor) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const upright = new Vector3(offset.x, offset.z, -offset.y); // Spherical has y up
    const place = new Spherical().setFromVector3(upright);
    place.theta += azimuth;
    place.phi = Math.min(Math.max(place.phi - elevation, 0.01), Math.PI - 0.01);
    place.radius /= factor;
    const moved = new Vector3().setFromSpherical(place);
    this.camera.position.set(moved.x, -moved.z, moved.y).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  aspect() {
    const element = this.panes[0]?.element;
    return element && element.clientHeight ? element.clientWidth / element.clientHeight : 1;
  }

  /** Pixels of the page that a millimetre at the object's centre takes. */
  pixelsPerUnit() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    const height = this.panes[0]?.element.clientHeight || 1;
    return height / (2 * Math.tan(((FIELD_OF_VIEW_DEG / 2) * Math.PI) / 180) * distance);
  }

  resize() {
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(this.canvas.clientWidth, this.canvas.clientHeight, false);
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = null;
      const whole = this.canvas.getBoundingClientRect();
      const ground = new Color(getComputedStyle(this.canvas).getPropertyValue("--stage").trim() || "#f4f5f7");
      this.light.position.copy(this.camera.position).sub(this.controls.target);
      for (const { scene, element } of this.panes) {
        const place = element.getBoundingClientRect();
        const [left, bottom] = [place.left - whole.left, whole.bottom - place.bottom];
        this.renderer.setViewport(left, bottom, place.width, place.height);
        this.renderer.setScissor(left, bottom, place.width, place.height);
        this.camera.aspect = place.width / Math.max(place.height, 1);
        this.camera.updateProjectionMatrix();
        scene.background = ground;
        scene.add(this.light);
        this.renderer.render(scene, this.camera);
      }
      this.drawn();
    });
  }
}
