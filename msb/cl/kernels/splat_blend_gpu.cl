// Front-to-back blending, GPU style: a work-group of 16 x 16 a tile, one sample a work-item, faces staged in
// local memory BATCH at a time; a group leaves when all its samples have stopped.

#define BATCH 64
#define GROUP (TILE * TILE)

// Through mere pointers to words a compiler need not see that faces were stored.
typedef union {
    Face face;
    uint words[FACE_WORDS];
} FaceAsWords;

__kernel __attribute__((reqd_work_group_size(TILE, TILE, 1))) void
blend(__constant View *view, __global const ulong *starts, __global const uint *list,
      __global const Face *faces, __global float *planes, uint first_tile_row, uint tile_rows)
{
    __local FaceAsWords staged[BATCH];
    __local uint numbers[BATCH];
    __local int alive;
    uint me = get_local_id(1) * TILE + get_local_id(0);
    uint tile = (first_tile_row + get_group_id(1)) * view->columns + get_group_id(0);
    uint column = get_global_id(0), row = first_tile_row * TILE + get_global_id(1);
    bool running = column < view->width && row < view->height;
    float x = (float)column, y = (float)row;

    float t = 1.0f, rgb_sum[3] = {0.0f, 0.0f, 0.0f}, z = 0.0f;
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
            alive = 1; // whoever writes writes the same
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!alive)
            break;
        uint here = (uint)min((ulong)BATCH, end - base);
        if (me < here)
            numbers[me] = list[base + me];
        barrier(CLK_LOCAL_MEM_FENCE);
        // Word by word, so that neighbours read neighbours.
        for (uint w = me; w < here * FACE_WORDS; w += GROUP) {
            __global const FaceAsWords *face = (__global const FaceAsWords *)(faces + numbers[w / FACE_WORDS]);
            staged[w / FACE_WORDS].words[w % FACE_WORDS] = face->words[w % FACE_WORDS];
        }
        barrier(CLK_LOCAL_MEM_FENCE);

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
            float weight = s.alpha * t, rgb[3], depth;
            shade(f, &c, y, &s, rgb, &depth);
            for (int i = 0; i < 3; i++)
                rgb_sum[i] = MAD(rgb[i], weight, rgb_sum[i]);
            z = MAD(depth, weight, z);
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
    }

    uint stride = view->columns * TILE;
    size_t plane = (size_t)stride * tile_rows * TILE;
    __global float *out = planes + (size_t)get_global_id(1) * stride + column;
    for (int i = 0; i < 3; i++)
        out[i * plane] = rgb_sum[i];
    out[3 * plane] = t;
    out[4 * plane] = z;
#if EXTRAS
    out[5 * plane] = normal.x;
    out[6 * plane] = normal.y;
    out[7 * plane] = normal.z;
    out[8 * plane] = median;
    ((__global int *)out)[9 * plane] = id;
#endif
}
