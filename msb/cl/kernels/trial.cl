// What every device has to build and run before it is used: eight lanes, a builtin that is a call on some platforms
// (a library built for another processor than the kernels takes vectors elsewhere), and integers.

__kernel void trial(__global const float8 *given, __global float8 *found, __global int8 *rounded, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    float8 x = given[i];
    found[i] = fmax(sqrt(x), 1.0f) * 0.5f;
    rounded[i] = convert_int8(x) + (x > 4.0f);
}
