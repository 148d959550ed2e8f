"use strict";
// Restores the arrays of the page; msb/engines/dedicated_page/storage.py describes their encodings.
const CHUNK = 192;  // rows per chunk of "grid"
const TYPES = { float32: Float32Array, uint32: Uint32Array, uint16: Uint16Array, uint8: Uint8Array };

// Returns the inflated content (`size` bytes) of the elements <script data-array="name"> of a page, and removes them.
async function storedBytes(name, size, page) {
  const parts = [...page.querySelectorAll("script[data-array]")].filter((part) => part.dataset.array === name);
  if (!parts.length) throw new Error(`the page does not contain the array "${name}"`);
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
  const result = new Uint8Array(size);
  let at = 0;
  const reader = source.pipeThrough(new DecompressionStream("deflate")).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    result.set(value, at);
    at += value.length;
  }
  if (at !== size) throw new Error(`the array "${name}" has ${at} bytes, not ${size}`);
  return result;
}

// Returns a table of values, row by row, from columns of byte planes.
function join(raw, rows, columns, Type) {
  const size = Type.BYTES_PER_ELEMENT, result = new Type(rows * columns);
  for (let column = 0; column < columns; column += 1) {
    const plane = column * size * rows;
    for (let row = 0, to = column; row < rows; row += 1, to += columns) {
      let value = raw[plane + row];
      for (let k = 1; k < size; k += 1) value |= raw[plane + k * rows + row] << (8 * k);
      result[to] = value;
    }
  }
  return result;
}

// Returns the float32 values from byte `start` on, which may be unaligned.
const floatsFrom = (raw, start) => new Float32Array(raw.slice(start).buffer);

const DECODERS = {
  plain(raw, head, rows, columns) {
    if (head.type !== "float32") {
      const result = join(raw, rows, columns, TYPES[head.type]);
      if (head.delta) for (let i = columns; i < result.length; i += 1) result[i] += result[i - columns];
      return result;
    }
    return new Float32Array(join(raw, rows, columns, Uint32Array).buffer);
  },
  palette(raw, head, rows, columns) {
    const codes = join(raw, rows, columns, Uint8Array), values = floatsFrom(raw, codes.length);
    const result = new Float32Array(codes.length);
    for (let column = 0; column < columns; column += 1) {
      for (let i = column; i < codes.length; i += columns) result[i] = values[256 * column + codes[i]];
    }
    return result;
  },
  rows(raw, head, rows, columns) {
    const codes = join(raw, rows, 1, TYPES[head.codes]), values = floatsFrom(raw, codes.byteLength);
    const result = new Float32Array(rows * columns);
    for (let row = 0, to = 0; row < rows; row += 1) {
      for (let k = codes[row] * columns, end = k + columns; k < end; k += 1, to += 1) result[to] = values[k];
    }
    return result;
  },
  grid(raw, head, rows, columns) {
    const codes = join(raw, rows, columns, Uint16Array), rest = floatsFrom(raw, codes.byteLength);
    const chunks = Math.ceil(rows / CHUNK), steps = rest.subarray(chunks * columns);
    const result = new Float32Array(codes.length);
    for (let i = 0; i < result.length; i += 1) {
      const chunk = Math.floor(i / columns / CHUNK);
      // The sum is exact: steps are powers of two, and all values are float32.
      result[i] = rest[chunk * columns + i % columns] + codes[i] * steps[chunk];
    }
    return result;
  },
};

// Returns the array `name` of a page; `head` describes its encoding.
export async function storedArray(name, head, page = document) {
  const rows = head.shape[0], columns = head.shape.slice(1).reduce((a, b) => a * b, 1);
  return DECODERS[head.how](await storedBytes(name, head.bytes, page), head, rows, columns);
}

// Returns triangles (three consecutive rows each), shrunk about their centroids in float32 arithmetic.
export function shrink(positions, factor) {
  const f = Math.fround, result = new Float32Array(positions.length);
  for (let i = 0; i < positions.length; i += 9) {
    for (let k = i; k < i + 3; k += 1) {
      const center = f(f(f(positions[k] + positions[k + 3]) + positions[k + 6]) / 3);
      for (let at = k; at < i + 9; at += 3) result[at] = f(f(positions[at] - center) * factor) + center;
    }
  }
  return result;
}
