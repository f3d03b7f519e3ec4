// Where the eye is: a rotation (rows: right, up, towards the eye), the point looked at, a distance.

const FIELD = Math.tan((14 * Math.PI) / 180); // half the height seen, at distance 1
const NEAREST = 0.02, FARTHEST = 40;

class Camera {
  // Looks along `view` at positions (arrays of x, y, z, x, ...) that fit a ball of radius 1.
  constructor(view, clouds) {
    this.start = view || [0.914, 0.407, 0, -0.099, 0.221, 0.97, 0.394, -0.886, 0.242];
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const p of clouds)
      for (let v = 0; v < p.length; v += 3)
        for (let k = 0; k < 3; k++) {
          const r = 3 * k, at = this.start[r] * p[v] + this.start[r + 1] * p[v + 1] + this.start[r + 2] * p[v + 2];
          if (at < low[k]) low[k] = at;
          if (at > high[k]) high[k] = at;
        }
    const middle = low.map((one, k) => (one + high[k]) / 2);
    this.half = low.map((one, k) => (high[k] - one) / 2);
    this.middle = [0, 1, 2].map((n) => [0, 1, 2].reduce((sum, k) => sum + middle[k] * this.start[3 * k + n], 0));
    this.reset();
  }

  reset() {
    this.rotation = [...this.start];
    this.centre = [...this.middle];
    this.distance = 0;
  }

  // All is seen, with a margin, in a picture `aspect` times as wide as high.
  fit(aspect) {
    const [right, up, depth] = this.half;
    this.distance = 1.16 * Math.max(right / aspect, up, 0.02) / FIELD + 0.6 * depth;
  }

  // Radians about the axes of the screen: up, right, and towards the eye.
  turn(about_up, about_right, about_eye = 0) {
    this.spin(0, 2, about_up);
    this.spin(2, 1, about_right);
    this.spin(1, 0, about_eye);
  }

  spin(i, j, angle) {
    const c = Math.cos(angle), s = Math.sin(angle), r = this.rotation;
    for (let k = 0; k < 3; k++) {
      const a = r[3 * i + k], b = r[3 * j + k];
      r[3 * i + k] = c * a + s * b;
      r[3 * j + k] = c * b - s * a;
    }
    // Rows drift apart after thousands of turns: up stays, right is made anew.
    const row = (n) => [r[3 * n], r[3 * n + 1], r[3 * n + 2]];
    const unit = (v) => v.map((one) => one / Math.hypot(...v));
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const up = unit(row(1)), right = unit(cross(up, row(2)));
    this.rotation = [...right, ...up, ...cross(right, up)];
  }

  // Shares of the height of the picture; what is under the finger stays there.
  pan(right, up) {
    const reach = 2 * FIELD * this.distance;
    for (let k = 0; k < 3; k++)
      this.centre[k] -= reach * (right * this.rotation[k] + up * this.rotation[3 + k]);
  }

  // `factor` above 1 comes closer, towards the place (right, up) in shares of the height.
  zoom(factor, right = 0, up = 0) {
    const before = this.distance;
    this.distance = Math.min(FARTHEST, Math.max(NEAREST, before / factor));
    const gone = before / this.distance - 1;
    this.pan(-right * gone, -up * gone);
  }

  // Column by column, as WebGL takes it: from model to view, and from view to the screen.
  view() {
    const r = this.rotation, c = this.centre;
    const moved = [0, 1, 2].map((k) => -(r[3 * k] * c[0] + r[3 * k + 1] * c[1] + r[3 * k + 2] * c[2]));
    moved[2] -= this.distance;
    return [r[0], r[3], r[6], 0, r[1], r[4], r[7], 0, r[2], r[5], r[8], 0, ...moved, 1];
  }

  projection(aspect) {
    const depth = this.distance + this.rotation[6] * this.centre[0] + this.rotation[7] * this.centre[1] + this.rotation[8] * this.centre[2];
    const far = depth + 1.01;
    const near = Math.max(depth - 1.01, far / 2000, 1e-4);
    const f = 1 / FIELD;
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
  }
}
