// Cameras and objects in the world frame, drawn on a canvas: one can turn it and come nearer.

const TURN_PER_PX = 0.008;
const KEY_TURN = 0.1;
const NEAREST = 0.05, FARTHEST = 20;

/** Rotates a point by a unit quaternion. */
function rotate([w, x, y, z], [a, b, c]) {
  const tx = 2 * (y * c - z * b), ty = 2 * (z * a - x * c), tz = 2 * (x * b - y * a);
  return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
}

/** A point by the rows of a homogeneous matrix. */
const moved = (rows, p) => rows.slice(0, 3).map((r) => r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);

export class Scene {
  /** Draws onto a canvas whenever something changes. */
  constructor(canvas) {
    this.canvas = canvas;
    this.cameras = [];
    this.objects = [];
    this.yaw = -0.6;
    this.pitch = 0.5;
    this.zoom = 1;
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      this.pointers.set(e.pointerId, [e.clientX, e.clientY]);
    });
    for (const kind of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(kind, (e) => this.pointers.delete(e.pointerId));
    }
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.nearer(Math.exp(-e.deltaY * 0.0015));
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  /** Cameras of a rig file in metres. */
  setRig(rig) {
    this.cameras = rig.cameras.map((camera) => {
      const { t, q_wxyz: q } = camera.T_world_cam;
      return { id: camera.id, t, q, camera };
    });
    this.fit();
  }

  /** Objects: their pose in the world as rows, and points with colors in their own frame. */
  setObjects(objects) {
    this.objects = objects;
    this.fit();
  }

  fit() {
    const all = [...this.cameras.map((c) => c.t), ...this.objects.map((o) => moved(o.pose, [0, 0, 0]))];
    if (!all.length) return;
    this.middle = [0, 1, 2].map((i) => all.reduce((sum, p) => sum + p[i], 0) / all.length);
    const far = (p) => Math.hypot(...p.map((x, i) => x - this.middle[i]));
    this.radius = Math.max(0.1, ...all.map(far)) * 1.1;
    this.draw();
  }

  move(e) {
    const before = this.pointers.get(e.pointerId);
    if (!before) return;
    const others = [...this.pointers].filter(([id]) => id !== e.pointerId).map(([, at]) => at);
    const now = [e.clientX, e.clientY];
    this.pointers.set(e.pointerId, now);
    if (others.length) {
      const apart = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]);
      this.nearer(apart(now) / Math.max(1, apart(before)));
      return;
    }
    this.turn((now[0] - before[0]) * TURN_PER_PX, (now[1] - before[1]) * TURN_PER_PX);
  }

  key(e) {
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (turns[e.key]) this.turn(...turns[e.key].map((x) => x * KEY_TURN));
    else if (e.key === "+") this.nearer(1.1);
    else if (e.key === "-") this.nearer(1 / 1.1);
    else return;
    e.preventDefault();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + pitch));
    this.draw();
  }

  nearer(factor) {
    this.zoom = Math.max(NEAREST, Math.min(FARTHEST, this.zoom * factor));
    this.draw();
  }

  /** Pixel of a point of the world, without perspective; and how near it is. */
  project(p) {
    const [x, y, z] = p.map((v, i) => v - this.middle[i]);
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    // z of the world is up: turn about it, then tilt.
    const across = cy * x - sy * y, ahead = sy * x + cy * y;
    const up = cp * z + sp * ahead, near = sp * z - cp * ahead;
    const scale = (Math.min(this.width, this.height) / 2 / this.radius) * this.zoom;
    return [this.width / 2 + across * scale, this.height / 2 - up * scale, near];
  }

  line(a, b, color) {
    const [from, to] = [this.project(a), this.project(b)];
    this.pen.strokeStyle = color;
    this.pen.beginPath();
    this.pen.moveTo(from[0], from[1]);
    this.pen.lineTo(to[0], to[1]);
    this.pen.stroke();
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    [this.width, this.height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!this.width || !this.middle) return;
    [this.canvas.width, this.canvas.height] = [this.width * ratio, this.height * ratio];
    this.pen = this.canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.pen.lineWidth = 1.5;
    this.pen.font = "12px system-ui, sans-serif";
    this.axes([0, 0, 0], (p) => p, this.radius * 0.2);
    for (const camera of this.cameras) this.drawCamera(camera);
    const dots = this.objects.flatMap((object) => object.points.map(({ at, color }) => {
      return [this.project(moved(object.pose, at)), color];
    }));
    dots.sort((a, b) => a[0][2] - b[0][2]);
    for (const [[x, y], color] of dots) {
      this.pen.fillStyle = `rgb(${color})`;
      this.pen.fillRect(x - 1.5, y - 1.5, 3, 3);
    }
    for (const object of this.objects) {
      this.axes([0, 0, 0], (p) => moved(object.pose, p), object.diameter * 0.8);
      const [x, y] = this.project(moved(object.pose, [0, 0, 0]));
      this.pen.fillStyle = "#e8eaed";
      this.pen.fillText(object.name, x + 8, y - 8);
    }
  }

  axes(origin, of, length) {
    const colors = ["#ff5a4d", "#4fd36b", "#6ea8ff"];
    colors.forEach((color, i) => {
      const end = [0, 1, 2].map((k) => origin[k] + (k === i ? length : 0));
      this.line(of(origin), of(end), color);
    });
  }

  /** A pyramid along its middle line of sight; lenses are drawn as pinholes. */
  drawCamera({ id, t, q, camera }) {
    const depth = this.radius * 0.18;
    const corner = (u, v) => {
      const ray = [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1];
      return rotate(q, ray.map((x) => x * depth)).map((x, i) => x + t[i]);
    };
    const [w, h] = [camera.width, camera.height];
    const corners = [corner(0, 0), corner(w, 0), corner(w, h), corner(0, h)];
    corners.forEach((c, i) => {
      this.line(t, c, "#9aa3ad");
      this.line(c, corners[(i + 1) % 4], i ? "#9aa3ad" : "#ffc043"); // the upper edge
    });
    const [x, y] = this.project(t);
    this.pen.fillStyle = "#9aa3ad";
    this.pen.fillText(id, x + 6, y + 4);
  }
}
