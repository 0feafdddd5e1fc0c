// What is drawn beside a mesh: axes, cameras, sparse points.

import {
  BufferAttribute, BufferGeometry, CanvasTexture, Group, LineBasicMaterial, LineSegments, Points, PointsMaterial, Sprite, SpriteMaterial, SRGBColorSpace,
} from "three";
import { decoded } from "./load.js";

const AXES = [
  ["x", [1, 0, 0], 0xd1483c],
  ["y", [0, 1, 0], 0x3f9a4a],
  ["z", [0, 0, 1], 0x3a78d0],
];

function lines(points, color) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color }));
}

function letter(text, color, size) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const pen = canvas.getContext("2d");
  pen.font = "600 52px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillStyle = `#${color.toString(16).padStart(6, "0")}`;
  pen.fillText(text, 32, 32);
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map: texture, depthTest: false }));
  sprite.scale.setScalar(size);
  return sprite;
}

/** The object's axes from its origin to `room` beyond the half extents of its box, with their letters. */
export function axes(half, room) {
  const group = new Group();
  AXES.forEach(([name, direction, color], axis) => {
    const length = half.getComponent(axis) + room;
    group.add(lines([0, 0, 0, ...direction.map((value) => value * length)], color));
    const sign = letter(name, color, room * 0.5);
    sign.position.set(...direction.map((value) => value * (length + room * 0.25)));
    group.add(sign);
  });
  return group;
}

/** Each registered camera as a pyramid that is `size` deep. */
export function cameras(scene, size) {
  const points = [];
  for (const { frame } of scene.cameras) {
    const [centre, right, down, forward] = [0, 3, 6, 9].map((start) => frame.slice(start, start + 3));
    const corner = (x, y) => centre.map((value, k) => value + size * (forward[k] + x * right[k] + y * down[k]));
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    corners.forEach((one, k) => points.push(...centre, ...one, ...one, ...corners[(k + 1) % 4]));
  }
  return lines(points, 0x6b7f99);
}

/** The sparse points in their colours. */
export function points(scene, size) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(decoded(scene.points, Float32Array), 3));
  geometry.setAttribute("color", new BufferAttribute(decoded(scene.point_colors, Uint8Array), 3, true));
  return new Points(geometry, new PointsMaterial({ size, vertexColors: true }));
}
