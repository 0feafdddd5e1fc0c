// A mesh of the report as an object of the scene, in every way it can be drawn.

import {
  BackSide, BufferAttribute, BufferGeometry, DoubleSide, FrontSide, Group, Mesh, MeshBasicMaterial, MeshLambertMaterial,
  SRGBColorSpace, TextureLoader,
} from "three";
import { heat } from "./colors.js";
import { decoded } from "./load.js";

export const MODES = ["textured", "shaded", "wireframe", "distance"];

/** Positions, normals, texture coordinates and colours of a mesh that came as a data script. */
function geometryOf(data) {
  const geometry = new BufferGeometry();
  const levels = decoded(data.positions, Uint16Array);
  const positions = Float32Array.from(levels, (level, k) => data.low[k % 3] + (level / 65535) * data.size[k % 3]);
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(decoded(data.normals, Int8Array), 3, true));
  geometry.setIndex(new BufferAttribute(decoded(data.index, data.wide ? Uint32Array : Uint16Array), 1));
  if (data.uv) geometry.setAttribute("uv", new BufferAttribute(decoded(data.uv, Uint16Array), 2, true));
  return geometry;
}

function textureOf(data, ready) {
  const texture = new TextureLoader().load(data.texture, ready);
  texture.colorSpace = SRGBColorSpace;
  texture.anisotropy = 4;
  return texture;
}

/** One mesh: `group` goes into a scene, `show(mode)` chooses how it is drawn. `changed` is called when a texture has arrived. */
export class Solid {
  constructor(data, changed) {
    this.data = data;
    this.group = new Group();
    this.geometry = geometryOf(data);
    this.changed = changed;
    this.distances = data.distances ? decoded(data.distances, Uint8Array) : null;
    this.materials = {
      front: new MeshLambertMaterial({ color: 0xb9bec6, side: FrontSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }),
      back: new MeshLambertMaterial({ color: 0xb0574c, side: BackSide }),
      wire: new MeshBasicMaterial({ color: 0x2c4a6b, wireframe: true }),
      distance: new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }),
      textured: this.#textured(),
    };
  }

  #textured() {
    if (this.data.texture) return new MeshBasicMaterial({ map: textureOf(this.data, () => this.changed()), side: DoubleSide });
    return new MeshLambertMaterial(this.data.colors ? { vertexColors: true, side: DoubleSide } : { color: 0xb9bec6, side: DoubleSide });
  }

  /** Distances to colour the mesh by, in place of its own. */
  setDistances(levels) {
    this.distances = levels;
  }

  show(mode) {
    const { front, back, wire, distance, textured } = this.materials;
    const parts = { textured: [textured], shaded: [front, back], wireframe: [front, back, wire], distance: this.distances ? [distance] : [front, back] };
    if (mode === "distance" && this.distances) {
      this.geometry.setAttribute("color", new BufferAttribute(heat(this.distances), 3));
    } else if (this.data.colors) {
      this.geometry.setAttribute("color", new BufferAttribute(decoded(this.data.colors, Uint8Array), 3, true));
    }
    this.group.clear();
    this.group.add(...parts[mode].map((material) => new Mesh(this.geometry, material)));
  }

  dispose() {
    this.geometry.dispose();
    this.materials.textured.map?.dispose();
    Object.values(this.materials).forEach((material) => material.dispose());
  }
}
