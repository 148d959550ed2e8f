// A test kernel that every device must build and run before use.
// The kernel uses eight lanes, integers, and a builtin that some platforms implement as a call.
// A function library may expect vectors in other registers if it was built for another processor.

__kernel void trial(__global const float8 *given, __global float8 *halves, __global int8 *rounded, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    float8 x = given[i];
    halves[i] = fmax(sqrt(x), 1.0f) * 0.5f;
    rounded[i] = convert_int8(x) + (x > 4.0f);
}
