// A vote of views on what is solid: the mean over them of how far each cell lies before the surface that they see.

#define UNKNOWN 2.0f

// What one view says of every cell. `camera` has the rows of the pose (12), fx, fy, cx and cy, for places in units of
// `unit`; `grid` the lowest corner and the size of a cell. A cell that lies more than `behind` what is seen is hidden;
// how far it lies before that counts up to `reach`. Depths are those of the pixels' centres, and are mixed only where
// they belong to one surface. Where a picture shows nothing, `depth` is 0, and all before it is air. `votes` has two
// numbers a cell: views that see it, and views that it is hidden from.
__kernel void vote(__constant float *camera, __constant float *grid, __global const float *depth, int width, int height,
    int nx, int ny, int nz, float unit, float reach, float behind, int contracted, __global float *sums,
    __global ushort *votes)
{
    size_t i = get_global_id(0);
    if (i >= (size_t)nx * ny * nz)
        return;
    float x = grid[0] + grid[3] * (float)(i / ((size_t)ny * nz));
    float y = grid[1] + grid[3] * (float)(i / nz % ny);
    float z = grid[2] + grid[3] * (float)(i % nz);
    if (contracted) {
        float size = fmax(sqrt(x * x + y * y + z * z), 1.0f), left = fmax(2.0f - size, 0.01f);
        float grow = 1.0f / (size * left);
        x *= grow, y *= grow, z *= grow;
        reach /= left * left, behind /= left * left;
    }
    float away = camera[8] * x + camera[9] * y + camera[10] * z + camera[11];
    if (away < 1e-4f)
        return;
    float u = camera[12] * (camera[0] * x + camera[1] * y + camera[2] * z + camera[3]) / away + camera[14];
    float v = camera[13] * (camera[4] * x + camera[5] * y + camera[6] * z + camera[7]) / away + camera[15];
    if (!(u >= 0.0f && v >= 0.0f && u < (float)width && v < (float)height))
        return;
    float seen = depth[(size_t)v * width + (size_t)u] / unit;
    float before = reach;
    if (seen > 0.0f && width > 1 && height > 1) {
        int column = clamp((int)floor(u - 0.5f), 0, width - 2), row = clamp((int)floor(v - 0.5f), 0, height - 2);
        float right = clamp(u - 0.5f - (float)column, 0.0f, 1.0f), down = clamp(v - 0.5f - (float)row, 0.0f, 1.0f);
        __global const float *near = depth + (size_t)row * width + column;
        float a = near[0] / unit, b = near[1] / unit, c = near[width] / unit, d = near[width + 1] / unit;
        float least = fmin(fmin(a, b), fmin(c, d)), most = fmax(fmax(a, b), fmax(c, d));
        if (least > 0.0f && most - least < reach)
            seen = (a * (1.0f - right) + b * right) * (1.0f - down) + (c * (1.0f - right) + d * right) * down;
    }
    if (seen > 0.0f)
        before = seen - away;
    if (before < -behind) {
        votes[2 * i + 1]++;
        return;
    }
    sums[i] += fmin(before / reach, 1.0f);
    votes[2 * i]++;
}

// The mean of what was said less `thick`, which is negative where a cell is solid. A soup has holes, and what a view
// sees through one is not there: where a cell is seen by less than a `share` of the views from which it is hidden, it
// is solid, and seen by twice as many it is what these say. One that no view has in its picture is unknown.
__kernel void count_votes(__global float *sums, __global const ushort *votes, float share, float thick, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    float seen = (float)votes[2 * i], hidden = share * (float)votes[2 * i + 1];
    float mean = seen > 0.0f ? sums[i] / seen : hidden > 0.0f ? -1.0f : UNKNOWN;
    float doubt = seen > 0.0f ? clamp(2.0f * hidden / seen - 1.0f, 0.0f, 1.0f) : 0.0f;
    sums[i] = seen > 0.0f ? fmax(mean - doubt * (mean + 1.0f) - thick, -1.0f) : mean;
}
