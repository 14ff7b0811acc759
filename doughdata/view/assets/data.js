// The packed arrays of the page (written by packing.py) and what they mean, key frame by key frame.
// Lengths are metres, the frame is the world's: z up, table at z = 0.

const ARRAY_TYPES = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, float32: Uint32Array };

/** All arrays by name, row-major, from their descriptions and the base64 text. */
async function unpackArrays(entries, text) {
  const packed = atob(text);
  const bytes = new Uint8Array(packed.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = packed.charCodeAt(i);
  const inflated = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(inflated).arrayBuffer());
  const arrays = {};
  let offset = 0;
  for (const entry of entries) {
    arrays[entry.name] = unpackArray(raw, offset, entry);
    offset += entry.rows * entry.columns * ARRAY_TYPES[entry.dtype].BYTES_PER_ELEMENT;
  }
  return arrays;
}

/** One array: byte planes together, columns to rows, differences summed (the type wraps). */
function unpackArray(raw, offset, { dtype, rows, columns, delta }) {
  const Type = ARRAY_TYPES[dtype];
  const count = rows * columns;
  const values = new Type(count);
  for (let column = 0, k = offset; column < columns; column++) {
    for (let row = 0; row < rows; row++, k++) {
      let value = 0;
      for (let plane = Type.BYTES_PER_ELEMENT - 1; plane >= 0; plane--) {
        value = value * 256 + raw[k + plane * count];
      }
      const at = row * columns + column;
      values[at] = delta && row > 0 ? values[at - columns] + value : value;
    }
  }
  return dtype === "float32" ? new Float32Array(values.buffer) : values;
}

/** Running totals of counts: [0, n0, n0 + n1, ...]. */
function offsetsOf(counts) {
  const offsets = [0];
  for (const count of counts) offsets.push(offsets[offsets.length - 1] + count);
  return offsets;
}

/** Everything the page shows of one scene. */
class SceneStore {
  constructor(header, arrays) {
    this.header = header;
    this.arrays = arrays;
    this.numFrames = header.timestamps.length;
    this.numParticles = arrays.positions.length / this.numFrames / 3;
    const perFrame = (list, k) => offsetsOf(list.map((counts) => counts[k]));
    if (header.graph) {
      this.nodeOffsets = perFrame(header.graph, 0);
      this.edgeOffsets = perFrame(header.graph, 1);
    }
    if (header.meshes) {
      const sums = header.meshes.map((parts) => [0, 1].map((k) => parts.reduce((sum, part) => sum + part[k], 0)));
      this.vertexOffsets = perFrame(sums, 0);
      this.faceOffsets = perFrame(sums, 1);
    }
    if (header.depth) {
      this.pixelOffsets = offsetsOf(header.depth.windows.map((w) => w.width * w.height));
      this.depthFrames = [...new Set(header.depth.windows.map((w) => w.frame))].sort((a, b) => a - b);
    }
  }

  /** Steps of the box to metres. */
  metres(steps) {
    const { low, step } = this.header.box;
    const points = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) points[i] = low[i % 3] + step * steps[i];
    return points;
  }

  /** Particles of a key frame as stored: steps of the box. */
  particleSteps(frame) {
    const size = this.numParticles * 3;
    return this.arrays.positions.subarray(frame * size, (frame + 1) * size);
  }

  /** Component of every particle, 255 = crumb; all 0 where topology was not checked. */
  labels(frame) {
    const { labels } = this.arrays;
    if (!labels) return new Uint8Array(this.numParticles);
    return labels.subarray(frame * this.numParticles, (frame + 1) * this.numParticles);
  }

  /** Surface of a key frame: vertices, smooth normals, component of every vertex, triangles. */
  mesh(frame) {
    const vertices = this.metres(
      this.arrays.mesh_vertices.subarray(3 * this.vertexOffsets[frame], 3 * this.vertexOffsets[frame + 1]),
    );
    const local = this.arrays.mesh_faces.subarray(3 * this.faceOffsets[frame], 3 * this.faceOffsets[frame + 1]);
    const faces = new Uint32Array(local);
    const components = new Uint8Array(vertices.length / 3);
    let firstVertex = 0;
    let firstIndex = 0;
    this.header.meshes[frame].forEach(([numVertices, numFaces], component) => {
      components.fill(component, firstVertex, firstVertex + numVertices);
      for (let i = firstIndex; i < firstIndex + 3 * numFaces; i++) faces[i] += firstVertex;
      firstVertex += numVertices;
      firstIndex += 3 * numFaces;
    });
    return { vertices, normals: smoothNormals(vertices, faces), components, faces };
  }

  /** Scene graph of a key frame. */
  graph(frame) {
    const [first, last] = [this.nodeOffsets[frame], this.nodeOffsets[frame + 1]];
    const edges = this.arrays.graph_edges.subarray(2 * this.edgeOffsets[frame], 2 * this.edgeOffsets[frame + 1]);
    return {
      nodes: this.metres(this.arrays.graph_nodes.subarray(3 * first, 3 * last)),
      components: this.arrays.graph_components.subarray(first, last),
      particles: this.arrays.graph_particles.subarray(first, last),
      edges,
    };
  }

  /** The key frame whose depth is shown at `frame`: the last rendered one, or the first. */
  depthFrame(frame) {
    const before = this.depthFrames.filter((rendered) => rendered <= frame);
    return before.length ? before[before.length - 1] : this.depthFrames[0];
  }

  /** All valid depth pixels of a rendered key frame: world points, depths, and widths there [m]. */
  cloud(frame) {
    const points = [];
    const depths = [];
    const sizes = [];
    this.header.depth.windows.forEach((view, number) => {
      if (view.frame !== frame) return;
      const start = this.pixelOffsets[number];
      for (let row = 0, k = start; row < view.height; row++) {
        for (let column = 0; column < view.width; column++, k++) {
          const z = this.arrays.depth[k] * this.header.depth.unit;
          if (z === 0) continue;
          const local = [((column - view.cx) / view.fx) * z, ((row - view.cy) / view.fy) * z, z];
          for (let axis = 0; axis < 3; axis++) {
            const r = view.rotation;
            points.push(
              r[3 * axis] * local[0] + r[3 * axis + 1] * local[1] + r[3 * axis + 2] * local[2] + view.position[axis],
            );
          }
          depths.push(z);
          sizes.push((0.8 * z) / view.fx);
        }
      }
    });
    return { points: new Float32Array(points), depths: new Float32Array(depths), sizes: new Float32Array(sizes) };
  }

  /** Both fingers at a key frame: triangles and edges as corner points in the world. */
  fingers(frame) {
    const tool = this.header.tools.used[frame];
    const vertices = this.arrays[`tool${tool}_vertices`];
    const poses = this.arrays.tool_poses;
    const size = poses.length / this.numFrames;
    const corners = { faces: [], edges: [] };
    for (let at = frame * size; at < (frame + 1) * size; at += 12) {
      for (const kind of ["faces", "edges"]) {
        for (const vertex of this.arrays[`tool${tool}_${kind}`]) {
          for (let axis = 0; axis < 3; axis++) {
            const row = at + 4 * axis;
            let value = poses[row + 3];
            for (let k = 0; k < 3; k++) value += poses[row + k] * vertices[3 * vertex + k];
            corners[kind].push(value);
          }
        }
      }
    }
    return { faces: new Float32Array(corners.faces), edges: new Float32Array(corners.edges) };
  }
}

/** Unit normals at the vertices: sum of the faces' normals, each as long as twice its area. */
function smoothNormals(vertices, faces) {
  const normals = new Float32Array(vertices.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const [ux, uy, uz] = [vertices[b] - vertices[a], vertices[b + 1] - vertices[a + 1], vertices[b + 2] - vertices[a + 2]];
    const [vx, vy, vz] = [vertices[c] - vertices[a], vertices[c + 1] - vertices[a + 1], vertices[c + 2] - vertices[a + 2]];
    const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const k of [a, b, c]) {
      normals[k] += nx;
      normals[k + 1] += ny;
      normals[k + 2] += nz;
    }
  }
  for (let k = 0; k < normals.length; k += 3) {
    const length = Math.hypot(normals[k], normals[k + 1], normals[k + 2]) || 1;
    for (let axis = 0; axis < 3; axis++) normals[k + axis] /= length;
  }
  return normals;
}
