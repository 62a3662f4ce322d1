// Undoes trajopt/view/replay/meshes.py: geometry of three.js from meshes in few bytes.

const CREASE = Math.cos(35 * Math.PI / 180);  // faces that meet at a larger angle keep their edge
const NORMAL_LEVELS = 254;

// Whole numbers of bytes that lie apart: all lowest bytes first.
function joined(bytes, planes) {
    const count = bytes.length / planes, values = new Uint32Array(count);
    for (let plane = 0; plane < planes; plane++) {
        for (let k = 0; k < count; k++) values[k] += bytes[plane * count + k] * 256 ** plane;
    }
    return values;
}

// Columns of `count` numbers, each the sum of the differences before it.
function summed(codes, count) {
    const values = new Int32Array(codes.length);
    for (let k = 0; k < codes.length; k++) {
        const change = codes[k] & 1 ? -(codes[k] + 1) / 2 : codes[k] / 2;
        values[k] = (k % count ? values[k - 1] : 0) + change;
    }
    return values;
}

function unfolded(u, v) {
    const x = 2 * u / NORMAL_LEVELS - 1, y = 2 * v / NORMAL_LEVELS - 1, z = 1 - Math.abs(x) - Math.abs(y);
    const px = z < 0 ? (1 - Math.abs(y)) * (x >= 0 ? 1 : -1) : x, py = z < 0 ? (1 - Math.abs(x)) * (y >= 0 ? 1 : -1) : y;
    const length = Math.hypot(px, py, z);
    return [px / length, py / length, z / length];
}

function restoredMesh(mesh) {
    const count = mesh.vertices, back = joined(mesh.index, 4), index = new Uint32Array(mesh.corners);
    for (let k = 0, next = 0; k < index.length; k++) {
        index[k] = next - back[k];
        if (back[k] === 0) next += 1;
    }
    const levels = summed(joined(mesh.position, 2), count), position = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) {
        for (let axis = 0; axis < 3; axis++) position[3 * k + axis] = mesh.low[axis] + mesh.step[axis] * levels[axis * count + k];
    }
    const colour = mesh.colour ? coloured(mesh, count) : null;
    if (!mesh.normal) return creased(position, index, colour);
    const folds = summed(joined(mesh.normal, 2), count), normal = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) normal.set(unfolded(folds[k], folds[count + k]), 3 * k);
    return {attributes: attributes(position, normal, colour), index: {type: "Uint32Array", array: index}};
}

function coloured(mesh, count) {
    const shades = summed(joined(mesh.colour, 4), count), colour = new Uint8Array(3 * count);
    for (let k = 0; k < count; k++) colour.set(mesh.palette.subarray(3 * shades[k], 3 * shades[k] + 3), 3 * k);
    return colour;
}

function attributes(position, normal, colour) {
    const found = {position: attribute(position), normal: attribute(normal)};
    if (colour) found.color = {itemSize: 3, type: "Uint8Array", array: colour, normalized: true};
    return found;
}

function attribute(array) {
    return {itemSize: 3, type: "Float32Array", array, normalized: false};
}

// Corners of their own, with the mean normal of the faces around the vertex that are nearly of the same side.
function creased(position, index, colour) {
    const corners = index.length, faces = corners / 3, face = new Float32Array(corners);
    for (let f = 0; f < faces; f++) face.set(faceNormal(position, index, f), 3 * f);
    const around = cornersOfVertices(index, position.length / 3);
    const points = new Float32Array(3 * corners), normal = new Float32Array(3 * corners);
    const shades = colour && new Uint8Array(3 * corners);
    for (let corner = 0; corner < corners; corner++) {
        const vertex = index[corner], own = 3 * Math.floor(corner / 3);
        const length = Math.hypot(face[own], face[own + 1], face[own + 2]) || 1;
        let x = 0, y = 0, z = 0;
        for (let k = around.start[vertex]; k < around.start[vertex + 1]; k++) {
            const other = 3 * Math.floor(around.corner[k] / 3), a = face[other], b = face[other + 1], c = face[other + 2];
            const cosine = (a * face[own] + b * face[own + 1] + c * face[own + 2]) / (length * (Math.hypot(a, b, c) || 1));
            if (cosine < CREASE && other !== own) continue;
            x += a;
            y += b;
            z += c;
        }
        const size = Math.hypot(x, y, z) || 1;
        normal[3 * corner] = x / size;
        normal[3 * corner + 1] = y / size;
        normal[3 * corner + 2] = z / size;
        for (let axis = 0; axis < 3; axis++) {
            points[3 * corner + axis] = position[3 * vertex + axis];
            if (colour) shades[3 * corner + axis] = colour[3 * vertex + axis];
        }
    }
    return {attributes: attributes(points, normal, shades)};
}

// A binary STL file as a server sends it, drawn as those of a page are; null for any other.
function smoothStl(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const faces = bytes.byteLength >= 84 ? view.getUint32(80, true) : 0;
    if (!faces || bytes.byteLength !== 84 + 50 * faces) return null;
    const position = new Float32Array(9 * faces), index = new Uint32Array(3 * faces);
    const bits = new Int32Array(position.buffer), table = new Int32Array(2 ** Math.ceil(Math.log2(6 * faces)));
    let count = 0;
    for (let corner = 0; corner < index.length; corner++) {
        const from = 84 + 50 * Math.floor(corner / 3) + 12 + 12 * (corner % 3), place = 3 * count;
        for (let axis = 0; axis < 3; axis++) position[place + axis] = view.getFloat32(from + 4 * axis, true);
        const same = vertex => [0, 1, 2].every(axis => bits[3 * vertex + axis] === bits[place + axis]);
        let slot = Math.imul(bits[place] ^ Math.imul(bits[place + 1], 73856093) ^ Math.imul(bits[place + 2], 19349663), 83492791) >>> 0;
        for (slot %= table.length; table[slot] && !same(table[slot] - 1);) slot = (slot + 1) % table.length;
        if (!table[slot]) table[slot] = ++count;
        index[corner] = table[slot] - 1;
    }
    return creased(position.subarray(0, 3 * count), index, null);
}

// Normal of a face, as long as twice its area.
function faceNormal(position, index, f) {
    const [a, b, c] = [3 * index[3 * f], 3 * index[3 * f + 1], 3 * index[3 * f + 2]];
    const ux = position[b] - position[a], uy = position[b + 1] - position[a + 1], uz = position[b + 2] - position[a + 2];
    const vx = position[c] - position[a], vy = position[c + 1] - position[a + 1], vz = position[c + 2] - position[a + 2];
    return [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
}

// The corners at each vertex: those of vertex k are corner[start[k]] to corner[start[k + 1] - 1].
function cornersOfVertices(index, vertices) {
    const start = new Uint32Array(vertices + 1), corner = new Uint32Array(index.length);
    for (const vertex of index) start[vertex + 1] += 1;
    for (let k = 0; k < vertices; k++) start[k + 1] += start[k];
    const next = start.slice();
    index.forEach((vertex, k) => { corner[next[vertex]++] = k; });
    return {start, corner};
}
