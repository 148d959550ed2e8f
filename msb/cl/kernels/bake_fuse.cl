// Find solid grid cells by votes of the views.
// The vote of a view is the distance of a grid cell in front of the visible surface.
// The votes of a cell are averaged.

// A view has these values: the rows of its pose (12), fx, fy, cx, cy, the width and height of its image, and
// the unit of its depths.
// RECORD is the number of values of a view.
// UNKNOWN marks a grid cell without votes.
// msb/bake/depth_fusion.py defines both constants.

// Add the votes of some views to every grid cell.
// Camera poses apply to positions in grid units.
// `grid` holds the lowest corner of the grid and the size of a cell.
// A cell is hidden if it lies behind the visible surface by more than `behind`.
// Distances in front of the surface are limited to `reach`.
// Depths belong to pixel centres, and are interpolated only within one surface.
// A depth of 0 means background, so the whole ray is empty.
// In a contracted scene, cells beyond `edge` stay unknown.
// The array `votes` has two numbers per cell.
// One number counts the views that see the cell; the other number counts the views that hide the cell.
__kernel void vote(__constant float *cameras, int views, __constant float *grid, __global const float *depths,
    int stride, int nx, int ny, int nz, float edge, float reach, float behind, int contracted, __global float *sums,
    __global ushort *votes)
{
    uint i = (uint)get_global_id(0), row = i / (uint)nz, plane = row / (uint)ny;
    if (plane >= (uint)nx)
        return;
    float x = grid[0] + grid[3] * (float)plane;
    float y = grid[1] + grid[3] * (float)(row - plane * (uint)ny);
    float z = grid[2] + grid[3] * (float)(i - row * (uint)nz);
    if (contracted) {
        float size = fmax(sqrt(x * x + y * y + z * z), 1.0f), left = fmax(2.0f - size, 0.01f);
        if (size > edge)
            return;
        float grow = 1.0f / (size * left);
        x *= grow, y *= grow, z *= grow;
        reach /= left * left, behind /= left * left;
    }
    float sum = sums[i];
    ushort seen = votes[2 * i], hidden = votes[2 * i + 1];
    for (int k = 0; k < views; k++) {
        __constant float *camera = cameras + RECORD * k;
        // Project the cell into the view.
        float away = camera[8] * x + camera[9] * y + camera[10] * z + camera[11];
        float inverse = 1.0f / away;
        if (away < 1e-4f)
            continue;
        float u = camera[12] * (camera[0] * x + camera[1] * y + camera[2] * z + camera[3]) * inverse + camera[14];
        float v = camera[13] * (camera[4] * x + camera[5] * y + camera[6] * z + camera[7]) * inverse + camera[15];
        if (!(u >= 0.0f && v >= 0.0f && u < camera[16] && v < camera[17]))
            continue;
        int width = (int)camera[16], height = (int)camera[17];
        float unit = camera[18];
        __global const float *depth = depths + k * stride;
        float there = depth[(int)v * width + (int)u] * unit;
        // Interpolated depths differ from the depth of the pixel by less than `reach`.
        bool is_near = fabs(there - away) < 2.0f * reach + behind;
        if (there > 0.0f && is_near && width > 1 && height > 1) {
            int column = clamp((int)floor(u - 0.5f), 0, width - 2), line = clamp((int)floor(v - 0.5f), 0, height - 2);
            float right = clamp(u - 0.5f - (float)column, 0.0f, 1.0f), down = clamp(v - 0.5f - (float)line, 0.0f, 1.0f);
            __global const float *near = depth + line * width + column;
            float a = near[0] * unit, b = near[1] * unit, c = near[width] * unit, d = near[width + 1] * unit;
            float least = fmin(fmin(a, b), fmin(c, d)), most = fmax(fmax(a, b), fmax(c, d));
            if (least > 0.0f && most - least < reach)
                there = (a * (1.0f - right) + b * right) * (1.0f - down) + (c * (1.0f - right) + d * right) * down;
        }
        // Distance of the cell in front of the surface; cells far behind the surface are hidden.
        float far = there > 0.0f ? there - away : reach;
        if (far < -behind) {
            hidden++;
        } else {
            sum += far < reach ? far / reach : 1.0f;
            seen++;
        }
    }
    sums[i] = sum;
    votes[2 * i] = seen;
    votes[2 * i + 1] = hidden;
}

// Replace the sum of votes by the average vote minus `thick`; the result is negative in solid cells.
// A triangle soup has holes, through which views see inside.
// Therefore a cell is solid if few views see it: less than `share` times the number of hiding views.
// If at least twice this number of views see the cell, the votes have their full weight.
// A cell outside all images has the value UNKNOWN.
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
