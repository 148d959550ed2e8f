// Exclusive prefix sum in CPU style.
// Each work-item processes a contiguous chunk, without local memory.
// The type SUM is uint or ulong.
// Sums wrap modulo 2^32 or 2^64.

__kernel void sum_chunks(__global const uint *values, __global SUM *starts, uint count, uint chunk)
{
    size_t c = get_global_id(0);
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    SUM sum = 0;
    for (size_t i = from; i < to; i++)
        sum += values[i];
    starts[c] = sum;
}

__kernel void scan_starts(__global SUM *starts, uint chunks)
{
    SUM sum = 0;
    for (uint c = 0; c < chunks; c++) {
        SUM here = starts[c];
        starts[c] = sum;
        sum += here;
    }
}

// `offsets` may share the memory of `values`, because each element is read before its position is written.
__kernel void scan_chunks(__global const uint *values, __global const SUM *starts, __global SUM *offsets,
                          uint count, uint chunk, uint chunks)
{
    size_t c = get_global_id(0);
    if (c >= chunks)
        return;
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    SUM sum = chunks > 1 ? starts[c] : 0;
    for (size_t i = from; i < to; i++) {
        uint value = values[i];
        offsets[i] = sum;
        sum += value;
    }
    if (c == chunks - 1)
        offsets[count] = sum;
}
