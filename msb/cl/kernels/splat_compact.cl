// From projected primitives to tile lists in depth order, for every method and both kernel styles.
//
// The primitives are sorted by depth before they are copied to tiles, because copying increases their number.
// Appending sorted primitives to tile lists equals the official stable sort of (tile << 32 | depth) keys.

typedef ushort4 Tiles; // x0, y0, x1, y1: low ends inclusive, high ends exclusive

// Work-item c of `project` lists primitives at the positions from c * chunk on. before[c] is the number of
// primitives listed by preceding work-items.
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
