#include "broken_part.cl"

__kernel void fine(__global int *out) { out[0] = part(1); }
