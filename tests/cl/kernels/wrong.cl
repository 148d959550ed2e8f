// Errors that Oclgrind must find.

__kernel void races(__global int *out) { out[0] = get_global_id(0); }

__kernel void reaches_beyond(__global int *out) { out[1 << 20] = 1; }

__kernel void diverges(__global int *out)
{
    if (get_local_id(0) & 1)
        barrier(CLK_GLOBAL_MEM_FENCE);
    out[get_global_id(0)] = 1;
}
