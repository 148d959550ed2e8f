// From projected primitives to tile lists in depth order; the same for every method. Included by both styles.
//
// Depth order comes first: N primitives are sorted, not N times their tiles. Appending them to tile lists in
// that order gives what the official kernels get by sorting (tile << 32 | depth) keys stably.

typedef ushort4 Tiles; // x0, y0, x1, y1: low inclusive, high exclusive

// Work-item c of `project` has listed primitives at places c * chunk, c * chunk + 1 ...; before[c] are those
// that others have listed before.
__kernel void compact(__global const uint *before, __global const uint *keys, __global uint *keys_out,
                      __global uint *places_out, uint items, uint chunk)
{
    size_t c = get_global_id(0);
    if (c >= items)
        return;
    size_t place = c * chunk;
    for (uint k = before[c]; k < before[c + 1]; k++, place++) {
        keys_out[k] = keys[place];
        places_out[k] = (uint)place;
    }
}
