// Draws meshes with WebGL2: one program, one array of positions and normals for each mesh.

const VERTEX_SHADER = `#version 300 es
uniform mat4 view, projection;
in vec3 position;
in vec4 normal;
in float deviation;
in vec4 own_colour;
out vec3 place, direction, own;
out float value;
void main() {
  vec4 seen = view * vec4(position, 1.0);
  place = seen.xyz;
  direction = mat3(view) * normal.xyz;
  value = deviation;
  own = own_colour.rgb;
  gl_Position = projection * seen;
}`;

// A strong light from one side shows relief, a weak one opens the shadows, and a sky above does
// the rest.  All of them go with the camera.
const FRAGMENT_SHADER = `#version 300 es
precision highp float;
uniform bool is_flat, is_mapped, is_painted, is_inside_out;
uniform float turn;
uniform vec2 range;
uniform vec3 clay;
uniform sampler2D colours;
in vec3 place, direction, own;
in float value;
out vec4 colour;
vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }
void main() {
  vec3 facet = normalize(cross(dFdx(place), dFdy(place)));
  vec3 eye = normalize(-place);
  if (dot(facet, eye) < 0.0) facet = -facet;
  bool is_back = gl_FrontFacing == is_inside_out;
  vec3 n = facet;
  if (!is_flat && dot(direction, direction) > 0.01) {
    // Round, but for creases and roughness: there the face has its say.
    vec3 smoothed = normalize(gl_FrontFacing ? direction : -direction);
    n = normalize(mix(facet, smoothed, smoothstep(0.65, 1.0, dot(smoothed, facet))));
  }
  vec3 key = normalize(vec3(cos(turn), sin(turn), 0.55));
  vec3 fill = normalize(vec3(-cos(turn + 0.5), -sin(turn + 0.5), 0.75));
  float light = 0.86 * max(dot(n, key), 0.0) + 0.20 * max(dot(n, fill), 0.0);
  light += 0.11 + 0.09 * n.y + 0.14 * n.z * n.z;
  vec3 paint = linear(clay);
  if (is_painted) {
    paint = linear(own);
    light = 0.08 + 0.84 * light; // colours may be dark
  } else if (is_back) paint = mix(paint, vec3(0.12, 0.17, 0.24), 0.62);
  if (is_mapped) {
    paint = linear(texture(colours, vec2((value - range.x) * range.y, 0.5)).rgb);
    light = 0.42 + 0.60 * light; // colours must be read in the shadow too
  }
  float gleam = pow(max(dot(n, normalize(key + eye)), 0.0), 42.0) * (is_mapped ? 0.04 : 0.10);
  float rim = pow(1.0 - max(dot(n, eye), 0.0), 4.0) * 0.06;
  colour = vec4(pow(paint * light * 1.06 + gleam + rim, vec3(1.0 / 2.2)), 1.0);
}`;

class Drawing {
  // Throws where there is no WebGL2.
  constructor(canvas, scene, view) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("no WebGL2");
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    ["position", "normal", "deviation", "own_colour"].forEach((name, k) => gl.bindAttribLocation(this.program, k, name));
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(this.program) || "the shader was refused");
    gl.useProgram(this.program);
    this.at = (name) => gl.getUniformLocation(this.program, name);
    this.parts = scene.meshes.map((mesh, k) => this.part(mesh, k === scene.meshes.length - 1 ? scene.deviation : null));
    if (scene.header.deviation) this.paint(scene.header.deviation);
    gl.uniform1i(this.at("is_inside_out"), isInsideOut(scene.meshes[0], view) ? 1 : 0);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
  }

  part(mesh, deviation) {
    const gl = this.gl;
    const part = { array: gl.createVertexArray(), count: mesh.corners.length, hasColours: !!mesh.colours };
    gl.bindVertexArray(part.array);
    const fill = (place, values, size, kind, normalized) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, kind, normalized, 0, 0);
    };
    fill(0, mesh.positions, 3, gl.FLOAT, false);
    fill(1, mesh.normals, 4, gl.SHORT, true);
    if (deviation) fill(2, new Uint16Array(deviation), 1, gl.UNSIGNED_SHORT, true);
    if (mesh.colours) fill(3, mesh.colours, 4, gl.UNSIGNED_BYTE, true);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.corners, gl.STATIC_DRAW);
    return part;
  }

  // The table of colours as a picture of one row, and which numbers are its ends.
  paint({ least, span, low, high, colours }) {
    const gl = this.gl;
    const table = Uint8Array.from(atob(colours), (one) => one.charCodeAt(0));
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, table.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, table);
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]])
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    gl.uniform2f(this.at("range"), (low - least) / span, span / (high - low));
  }

  // `split`: the share of the width that shows the first mesh.
  draw(camera, { split, isFlat, isMapped, isPainted, turn, clay }) {
    const gl = this.gl;
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    gl.viewport(0, 0, width, height);
    gl.uniformMatrix4fv(this.at("view"), false, camera.view());
    gl.uniformMatrix4fv(this.at("projection"), false, camera.projection(width / height));
    gl.uniform1i(this.at("is_flat"), isFlat ? 1 : 0);
    gl.uniform1f(this.at("turn"), turn);
    gl.uniform3fv(this.at("clay"), clay);
    const cut = this.parts.length > 1 ? Math.round(split * width) : 0;
    this.half(this.parts[0], 0, cut, false, isPainted);
    this.half(this.parts.at(-1), cut, width - cut, isMapped, isPainted);
  }

  half(part, left, width, isMapped, isPainted) {
    if (width <= 0) return;
    const gl = this.gl;
    gl.scissor(left, 0, width, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform1i(this.at("is_mapped"), isMapped ? 1 : 0);
    gl.uniform1i(this.at("is_painted"), isPainted && part.hasColours && !isMapped ? 1 : 0);
    gl.bindVertexArray(part.array);
    gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_INT, 0);
  }
}

// Whether the faces are wound clockwise seen from outside: by the volume that they enclose, or, of
// a sheet, by the side that is seen at the start.
function isInsideOut({ positions: p, corners }, view) {
  const sum = [0, 0, 0];
  let volume = 0, area = 0;
  for (let c = 0; c < corners.length; c += 3) {
    const i = 3 * corners[c], j = 3 * corners[c + 1], k = 3 * corners[c + 2];
    const u = [0, 1, 2].map((n) => p[j + n] - p[i + n]);
    const w = [0, 1, 2].map((n) => p[k + n] - p[i + n]);
    const cross = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
    cross.forEach((one, n) => (sum[n] += one));
    area += Math.hypot(...cross);
    volume += p[i] * cross[0] + p[i + 1] * cross[1] + p[i + 2] * cross[2];
  }
  if (Math.hypot(...sum) > 0.2 * area) return sum[0] * view[6] + sum[1] * view[7] + sum[2] * view[8] < 0;
  return volume < 0;
}
