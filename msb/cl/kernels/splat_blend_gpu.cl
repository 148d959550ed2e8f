// Front-to-back blending in GPU style: a work-group of 16 x 16 per tile, one sample per work-item.
// Faces are loaded into local memory in batches of BATCH faces.
// A work-group ends when all its samples have stopped.

#if SHARES
#define BATCH 16 // number of faces whose weights at all samples fit into local memory
#else
#define BATCH 64
#endif
#define GROUP (TILE * TILE)

// The union is needed because a compiler may miss stores of faces through pointers to words.
typedef union {
    Face face;
    uint words[FACE_WORDS];
} FaceAsWords;

__kernel __attribute__((reqd_work_group_size(TILE, TILE, 1))) void
BLEND(__constant View *view, __global const ulong *starts, __global const uint *list,
      __global const Face *faces, __global float *planes, uint first_tile_row, uint tile_rows SUMS)
{
    __local FaceAsWords staged[BATCH];
    __local uint numbers[BATCH];
    __local int alive;
    uint me = get_local_id(1) * TILE + get_local_id(0);
    uint tile = (first_tile_row + get_group_id(1)) * view->columns + get_group_id(0);
    uint column = get_global_id(0), row = first_tile_row * TILE + get_global_id(1);
    bool running = column < view->width && row < view->height;
    float x = (float)column, y = (float)row;

    uint stride = view->columns * TILE;
    size_t plane = (size_t)stride * tile_rows * TILE;
    planes += (size_t)get_global_id(1) * stride + column;

    float t = 1.0f;
#if SHARES
    __local float spread[4][GROUP], weights[BATCH][GROUP], of_columns[BATCH][4][TILE];
    for (int i = 0; i < 4; i++)
        spread[i][me] = planes[i * plane];
#else
    float rgb_sum[3] = {0.0f, 0.0f, 0.0f}, z = 0.0f;
#endif
#if EXTRAS
    float3 normal = (float3)(0.0f);
    float median = 0.0f;
    int id = -1;
#endif
    ulong end = starts[tile + 1];
    for (ulong base = starts[tile]; base < end; base += BATCH) {
        if (me == 0)
            alive = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (running)
            alive = 1; // all work-items write the same value
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!alive)
            break;
        uint here = (uint)min((ulong)BATCH, end - base);
        if (me < here)
            numbers[me] = list[base + me];
        barrier(CLK_LOCAL_MEM_FENCE);
        // Copy word by word, so that adjacent work-items read adjacent words.
        for (uint w = me; w < here * FACE_WORDS; w += GROUP) {
            __global const FaceAsWords *face = (__global const FaceAsWords *)(faces + numbers[w / FACE_WORDS]);
            staged[w / FACE_WORDS].words[w % FACE_WORDS] = face->words[w % FACE_WORDS];
        }
        barrier(CLK_LOCAL_MEM_FENCE);

#if SHARES
        for (uint k = 0; k < BATCH; k++)
            weights[k][me] = 0.0f;
#endif
        for (uint k = 0; k < here && running; k++) {
            FACE_POINTER f = &staged[k].face;
            if ((int)column < f->x0 || (int)column > f->x1 || (int)row < f->y0 || (int)row > f->y1)
                continue;
            Columns c = columns_of(f, x, view);
            Sample s;
            mask within = inside(f, &c, y, view, &s);
            if (!within || !cover(f, view, within, &s))
                continue;
            float after = t * (1.0f - s.alpha);
#if !BLENDS_CROSSING
            if (after < MIN_TRANSMITTANCE) {
                running = false;
                break;
            }
#endif
            float weight = s.alpha * t;
#if SHARES
            weights[k][me] = weight;
#else
            float rgb[3], depth;
            shade(f, &c, y, &s, rgb, &depth);
            for (int i = 0; i < 3; i++)
                rgb_sum[i] = MAD(rgb[i], weight, rgb_sum[i]);
            z = MAD(depth, weight, z);
#endif
#if EXTRAS
            normal = normal + normal_of(f) * weight;
            if (t > 0.5f) {
                median = depth;
                id = f->number;
            }
#endif
            t = after;
#if BLENDS_CROSSING
            if (t <= MIN_TRANSMITTANCE)
                running = false;
#endif
        }
#if SHARES
        // Each work-item sums a column of samples of a face; then the group adds the sums of the columns.
        barrier(CLK_LOCAL_MEM_FENCE);
        float sum[4] = {0.0f, 0.0f, 0.0f, 0.0f};
        for (uint k = me % TILE; k < GROUP; k += TILE)
            for (int i = 0; i < 4; i++)
                sum[i] = MAD(weights[me / TILE][k], spread[i][k], sum[i]);
        for (int i = 0; i < 4; i++)
            of_columns[me / TILE][i][me % TILE] = sum[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        if (me < 4 * here) {
            float all = 0.0f;
            for (int k = 0; k < TILE; k++)
                all += of_columns[me / 4][me % 4][k];
            sums[4 * base + me] = all;
        }
#endif
    }

#if !SHARES
    for (int i = 0; i < 3; i++)
        planes[i * plane] = rgb_sum[i];
    planes[3 * plane] = t;
    planes[4 * plane] = z;
#if EXTRAS
    planes[5 * plane] = normal.x;
    planes[6 * plane] = normal.y;
    planes[7 * plane] = normal.z;
    planes[8 * plane] = median;
    ((__global int *)planes)[9 * plane] = id;
#endif
#endif
}
