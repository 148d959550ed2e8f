// This file solves the equations of msb/bake/texture_equations.py by conjugate gradients.
// Red, green and blue are solved together, in x, y and z.
// Each work-item handles RUN consecutive texels, so sums are equal in every run.
// msb/bake/texture_equations.py defines RUN.
// The constant NOTHING, in the same file, is the residual below which a solution is exact.

// Tie neighbouring texels of a chart to each other, and tie a texel without neighbours to its current value.
// Without these ties, texels that no image shows could take arbitrary values.
__kernel void tie(__global const int *charts, float weight, int side, __global float8 *equations, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    int x = (int)(i % side), y = (int)(i / side), chart = charts[i];
    float left = x > 0 && charts[i - 1] == chart, right = x + 1 < side && charts[i + 1] == chart;
    float above = y > 0 && charts[i - side] == chart, below = y + 1 < side && charts[i + side] == chart;
    float8 tied = (float8)(fmax(left + right + above + below, 1.0f), -right, -below, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f);
    equations[i] += weight * tied;
}

// Add the contributions of smaller levels to the right-hand sides of a level. The right-hand sides begin at
// `start`. Add the same contributions to the level's diagonal in w. The next smaller level begins at `next`;
// 0 marks the smallest level.
__kernel void spread(__global float8 *equations, uint start, uint next, int side, __global float4 *direction,
    uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    float8 row = equations[start + i];
    float4 first = (float4)(0.0f, 0.0f, 0.0f, row.s0);
    if (next) {
        size_t part_of = next + i / side / 2 * (side / 2) + i % side / 2;
        row.s567 += 0.25f * equations[part_of].s567;
        first.w += 0.0625f * direction[part_of].w;
        equations[start + i] = row;
    }
    direction[start + i] = first;
}

// Store the inverse of the diagonal in w, and set the change to zero.
// Turn right-hand sides into residuals.
// Return partial sums of the squared residuals, weighted by the inverse diagonal.
__kernel void begin(__global const float8 *equations, __global float4 *direction, __global float *change,
    __global float4 *partial, uint count)
{
    size_t run = get_global_id(0), end = min((run + 1) * RUN, (size_t)count);
    if (run * RUN >= count)
        return;
    float4 total = 0.0f;
    for (size_t i = run * RUN; i < end; i++) {
        float3 left = equations[i].s567;
        float diagonal = direction[i].w, inverse = diagonal > NOTHING ? 1.0f / diagonal : 0.0f;
        direction[i].w = inverse;
        vstore3((float3)(0.0f), i, change);
        total.xyz += inverse * left * left;
    }
    partial[run] = total;
}

// The next search direction is the sum of two vectors.
// The vectors are the residual scaled by the inverse diagonal, and the previous direction multiplied by
// `again`.
__kernel void turn(__global const float8 *equations, float4 again, __global float4 *direction, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    float4 before = direction[i];
    before.xyz = again.xyz * before.xyz + before.w * equations[i].s567;
    direction[i] = before;
}

// The texels of a smaller level begin at `start`; a row has `side` texels.
// Each texel is the average of four texels of the larger level.
__kernel void halve(__global float4 *direction, uint before, uint start, int side, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    __global const float4 *four = direction + before + i / side * 4 * side + i % side * 2;
    direction[start + i] = 0.25f * (four[0] + four[1] + four[2 * side] + four[2 * side + 1]);
}

// Compute the left-hand sides of a level with the contributions of smaller levels.
// Return partial sums of the products of the left-hand sides with `direction`.
__kernel void apply(__global const float8 *equations, __global const float4 *direction, uint start, uint next, int side,
    __global float *sums, __global float4 *partial, uint count)
{
    size_t run = get_global_id(0), end = min((run + 1) * RUN, (size_t)count);
    if (run * RUN >= count)
        return;
    equations += start;
    direction += start;
    float4 total = 0.0f;
    int x = (int)(run * RUN % side), y = (int)(run * RUN / side);
    for (size_t i = run * RUN; i < end; i++) {
        bool left = x > 0, right = x + 1 < side;
        float8 row = equations[i];
        float4 sum = row.s0 * direction[i];
        if (right)
            sum += row.s1 * direction[i + 1];
        if (left)
            sum += equations[i - 1].s1 * direction[i - 1];
        if (y + 1 < side) {
            sum += row.s2 * direction[i + side];
            if (right)
                sum += row.s3 * direction[i + side + 1];
            if (left)
                sum += row.s4 * direction[i + side - 1];
        }
        if (y > 0) {
            sum += equations[i - side].s2 * direction[i - side];
            if (left)
                sum += equations[i - side - 1].s3 * direction[i - side - 1];
            if (right)
                sum += equations[i - side + 1].s4 * direction[i - side + 1];
        }
        if (next)
            sum.xyz += 0.25f * vload3(next + y / 2 * (side / 2) + x / 2, sums);
        vstore3(sum.xyz, start + i, sums);
        total += sum * direction[i];
        if (++x == side) {
            x = 0;
            y++;
        }
    }
    partial[run] = total;
}

// Advance the solution by `length` along `direction`; return partial sums of the squared residual.
__kernel void advance(__global const float4 *direction, __global const float *sums, float4 length,
    __global float8 *equations, __global float *change, __global float4 *partial, uint count)
{
    size_t run = get_global_id(0), end = min((run + 1) * RUN, (size_t)count);
    if (run * RUN >= count)
        return;
    float4 total = 0.0f;
    for (size_t i = run * RUN; i < end; i++) {
        float4 way = direction[i];
        vstore3(vload3(i, change) + length.xyz * way.xyz, i, change);
        float3 left = equations[i].s567 - length.xyz * vload3(i, sums);
        equations[i].s567 = left;
        total.xyz += way.w * left * left;
    }
    partial[run] = total;
}
