// Unpacks a scene: the other half of view/scene.py, where the form is described.

async function unpacked(text) {
  const letters = atob(text.trim());
  const packed = Uint8Array.from(letters, (one) => one.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  let at = 4 + length;

  // `count` numbers whose bytes lie in planes, lowest first.
  const numbers = (count, ranks) => {
    const values = new Int32Array(count);
    for (let rank = 0; rank < ranks; rank++, at += count)
      for (let k = 0; k < count; k++) values[k] |= bytes[at + k] << (8 * rank);
    return values;
  };
  const columns = (count) => [0, 1, 2].map(() => numbers(count, 3));
  const step = (value) => (value >>> 1) ^ -(value & 1);

  const meshes = [];
  for (const { vertices, faces, moved } of header.meshes) {
    if (moved) {
      const base = meshes[0];
      const ticks = columns(vertices).map((axis, k) => axis.map((one, v) => base.ticks[k][v] + step(one)));
      meshes.push({ corners: base.corners, ticks });
      continue;
    }
    const corners = new Uint32Array(numbers(3 * faces, 3));
    let known = 0;
    for (let c = 0; c < corners.length; c++) {
      corners[c] = known - corners[c];
      if (corners[c] === known) known++;
    }
    const ticks = columns(vertices);
    for (const axis of ticks) for (let v = 0; v < vertices; v++) axis[v] = (v && axis[v - 1]) + step(axis[v]);
    meshes.push({ corners, ticks });
  }
  const deviation = header.deviation ? numbers(meshes.at(-1).ticks[0].length, 2) : null;
  header.meshes.forEach(({ vertices, painted }, k) => {
    if (!painted) return;
    // Four bytes to a vertex, because odd strides are slow.
    const colours = (meshes[k].colours = new Uint8Array(4 * vertices));
    for (let part = 0; part < 3; part++, at += vertices)
      for (let v = 0; v < vertices; v++) colours[4 * v + part] = bytes[at + v];
  });
  return { header, meshes, deviation };
}

// Positions of all meshes about their common middle, so that they fit a ball of radius 1.
function placed(scene) {
  const low = [0, 1, 2].map(() => Infinity);
  const high = [0, 1, 2].map(() => -Infinity);
  for (const mesh of scene.meshes)
    mesh.ticks.forEach((axis, k) => {
      for (const one of axis) {
        if (one < low[k]) low[k] = one;
        if (one > high[k]) high[k] = one;
      }
    });
  const middle = low.map((one, k) => (one + high[k]) / 2);
  const radius = Math.hypot(...low.map((one, k) => high[k] - one)) / 2 || 1;
  for (const mesh of scene.meshes) {
    const count = mesh.ticks[0].length;
    mesh.positions = new Float32Array(3 * count);
    mesh.ticks.forEach((axis, k) => {
      for (let v = 0; v < count; v++) mesh.positions[3 * v + k] = (axis[v] - middle[k]) / radius;
    });
    mesh.ticks = null;
    mesh.normals = vertexNormals(mesh.positions, mesh.corners);
  }
  return radius * scene.header.step; // file units in the length 1
}

// Normals weighted by area, as signed 16-bit numbers, four to a vertex.
function vertexNormals(p, corners) {
  const sums = new Float32Array(p.length);
  for (let c = 0; c < corners.length; c += 3) {
    const i = 3 * corners[c], j = 3 * corners[c + 1], k = 3 * corners[c + 2];
    const ux = p[j] - p[i], uy = p[j + 1] - p[i + 1], uz = p[j + 2] - p[i + 2];
    const wx = p[k] - p[i], wy = p[k + 1] - p[i + 1], wz = p[k + 2] - p[i + 2];
    const nx = uy * wz - uz * wy, ny = uz * wx - ux * wz, nz = ux * wy - uy * wx;
    for (const v of [i, j, k]) {
      sums[v] += nx;
      sums[v + 1] += ny;
      sums[v + 2] += nz;
    }
  }
  const normals = new Int16Array((4 * p.length) / 3);
  for (let v = 0, n = 0; v < p.length; v += 3, n += 4) {
    const length = Math.hypot(sums[v], sums[v + 1], sums[v + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[n + k] = Math.round((32767 * sums[v + k]) / length);
  }
  return normals;
}
