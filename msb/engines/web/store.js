"use strict";
// Arrays out of the page: msb/engines/dedicated_page/stored.py says how they lie in it.
const CHUNK = 192;  // rows of a chunk of "grid"
const TYPES = { float32: Float32Array, uint32: Uint32Array, uint16: Uint16Array, uint8: Uint8Array };

// The bytes of the elements <script data-array="name"> of a page, inflated; the elements are gone then.
async function storedBytes(name, size, page) {
  const parts = [...page.querySelectorAll("script[data-array]")].filter((part) => part.dataset.array === name);
  if (!parts.length) throw new Error(`this page lacks its array "${name}"`);
  const texts = parts.map((part) => part.textContent.trim());
  for (const part of parts) part.remove();
  let next = 0;
  const source = new ReadableStream({
    pull(controller) {
      if (next === texts.length) { controller.close(); return; }
      const text = atob(texts[next]), bytes = new Uint8Array(text.length);
      for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
      texts[next] = "";
      next += 1;
      controller.enqueue(bytes);
    },
  });
  const found = new Uint8Array(size);
  let at = 0;
  const reader = source.pipeThrough(new DecompressionStream("deflate")).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    found.set(value, at);
    at += value.length;
  }
  if (at !== size) throw new Error(`array "${name}" has ${at} bytes, not ${size}`);
  return found;
}

// Columns of byte planes become rows of values.
function joined(raw, rows, columns, Type) {
  const size = Type.BYTES_PER_ELEMENT, found = new Type(rows * columns);
  for (let column = 0; column < columns; column += 1) {
    const plane = column * size * rows;
    for (let row = 0, to = column; row < rows; row += 1, to += columns) {
      let value = raw[plane + row];
      for (let k = 1; k < size; k += 1) value |= raw[plane + k * rows + row] << (8 * k);
      found[to] = value;
    }
  }
  return found;
}

// Numbers behind the codes, which need not begin at a multiple of four bytes.
const floatsFrom = (raw, start) => new Float32Array(raw.slice(start).buffer);

const DECODERS = {
  plain(raw, head, rows, columns) {
    if (head.type !== "float32") {
      const found = joined(raw, rows, columns, TYPES[head.type]);
      if (head.delta) for (let i = columns; i < found.length; i += 1) found[i] += found[i - columns];
      return found;
    }
    return new Float32Array(joined(raw, rows, columns, Uint32Array).buffer);
  },
  palette(raw, head, rows, columns) {
    const codes = joined(raw, rows, columns, Uint8Array), values = floatsFrom(raw, codes.length);
    const found = new Float32Array(codes.length);
    for (let column = 0; column < columns; column += 1) {
      for (let i = column; i < codes.length; i += columns) found[i] = values[256 * column + codes[i]];
    }
    return found;
  },
  rows(raw, head, rows, columns) {
    const codes = joined(raw, rows, 1, TYPES[head.codes]), values = floatsFrom(raw, codes.byteLength);
    const found = new Float32Array(rows * columns);
    for (let row = 0, to = 0; row < rows; row += 1) {
      for (let k = codes[row] * columns, end = k + columns; k < end; k += 1, to += 1) found[to] = values[k];
    }
    return found;
  },
  grid(raw, head, rows, columns) {
    const codes = joined(raw, rows, columns, Uint16Array), rest = floatsFrom(raw, codes.byteLength);
    const chunks = Math.ceil(rows / CHUNK), steps = rest.subarray(chunks * columns);
    const found = new Float32Array(codes.length);
    for (let i = 0; i < found.length; i += 1) {
      const chunk = Math.floor(i / columns / CHUNK);
      // Exact: steps are powers of two and every sum is a float32.
      found[i] = rest[chunk * columns + i % columns] + codes[i] * steps[chunk];
    }
    return found;
  },
};

export async function storedArray(name, head, page = document) {
  const rows = head.shape[0], columns = head.shape.slice(1).reduce((a, b) => a * b, 1);
  return DECODERS[head.how](await storedBytes(name, head.bytes, page), head, rows, columns);
}

// Triangles, rows of three corners, shrunk about their centroids: in float32, each step rounded.
export function shrunk(positions, factor) {
  const f = Math.fround, found = new Float32Array(positions.length);
  for (let i = 0; i < positions.length; i += 9) {
    for (let k = i; k < i + 3; k += 1) {
      const center = f(f(f(positions[k] + positions[k + 3]) + positions[k + 6]) / 3);
      for (let at = k; at < i + 9; at += 3) found[at] = f(f(positions[at] - center) * factor) + center;
    }
  }
  return found;
}
