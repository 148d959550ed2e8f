// One pass of a stable radix sort in CPU style.
// Each work-item processes a contiguous chunk with a private histogram.
// The type KEY is uint or ulong.
// A pass sorts by the digit (key >> shift) & mask, where mask < DIGITS.

#define DIGIT(key) ((uint)((key) >> shift) & mask)

// The array `counts` is digit-major.
// The exclusive prefix sum of `counts` gives the write position of each digit of each chunk.
__kernel void count_digits(__global const KEY *keys, __global uint *counts, uint count, uint chunk,
                           uint chunks, uint shift, uint mask)
{
    size_t c = get_global_id(0);
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    uint mine[DIGITS];
    for (uint d = 0; d <= mask; d++)
        mine[d] = 0;
    for (size_t i = from; i < to; i++)
        mine[DIGIT(keys[i])]++;
    for (uint d = 0; d <= mask; d++)
        counts[d * chunks + c] = mine[d];
}

// If `number` is set, the values are element numbers, and `values` is not read.
__kernel void move_pairs(__global const KEY *restrict keys, __global const uint *restrict values,
                         __global KEY *restrict keys_out, __global uint *restrict values_out,
                         __global const uint *restrict places, uint count, uint chunk, uint chunks,
                         uint shift, uint mask, uint number)
{
    size_t c = get_global_id(0);
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    uint next[DIGITS];
    for (uint d = 0; d <= mask; d++)
        next[d] = places[d * chunks + c];
    for (size_t i = from; i < to; i++) {
        KEY key = keys[i];
        uint place = next[DIGIT(key)]++;
        keys_out[place] = key;
        values_out[place] = number ? (uint)i : values[i];
    }
}
