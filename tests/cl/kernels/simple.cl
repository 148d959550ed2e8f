#include "helper.cl"

__kernel void scaled(__global const float *in, __global float *out, uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        out[i] = helped(in[i]);
}

__kernel void typed(__global float *out, float4 four, uint3 three, ulong wide, char narrow,
                    __local float *work)
{
    work[0] = four.s3;
    out[0] = work[0];
    out[1] = three.s2;
    out[2] = wide;
    out[3] = narrow;
}

__kernel void fused(__global const float *in, __global float *out, uint count)
{
#pragma OPENCL FP_CONTRACT OFF
    size_t i = get_global_id(0);
    if (i < count) {
        out[2 * i] = in[3 * i] * in[3 * i + 1] + in[3 * i + 2];
        out[2 * i + 1] = in[3 * i] / in[3 * i + 1];
    }
}
