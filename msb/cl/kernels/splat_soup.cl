// Code shared by methods with independent triangles, which have three corners and one colour per face.

#include "splat_color.cl"

#define VERTEX_COLORS 0
#define COLORS 3

void corners_of(const size_t *rows, __global const float *positions, __global const uint *indices,
                vec3 *corners)
{
    real values[9];
    load_members(positions, rows, 9, 9, values);
    for (int k = 0; k < 3; k++)
        corners[k] = (vec3){values[3 * k], values[3 * k + 1], values[3 * k + 2]};
}

// Colours are evaluated at the centroid; the color array holds the centroid until color_faces runs.
void color_later(const vec3 *p, real *color)
{
    vec3 center = center_of(p[0], p[1], p[2]);
    color[0] = center.x;
    color[1] = center.y;
    color[2] = center.z;
}

#if LANES == 8
void prefetch_face(size_t row, const Source *source)
{
    prefetch_row(source->positions, row, 9);
    prefetch_row(source->coverage, row, COVERAGE);
}

void prefetch_colors(size_t row, const Source *source, __constant View *view)
{
    prefetch_row(source->f_rest, row, view->rest_stride);
    PREFETCH_FAR(source->f_dc + 3 * row);
}
#endif
