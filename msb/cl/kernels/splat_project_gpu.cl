// Projection in GPU style.
// Each face has one work-item; the projected face is stored at the position of its row.

// `listed` is 1 if the face is listed, else 0.
__kernel void project(__constant View *view, __global const float *bounds, __global const uint *numbers,
                      __global const float *positions, __global const uint *indices,
                      __global const float *coverage, __global const float *f_dc,
                      __global const float *f_rest, __global Face *faces, __global uint *keys,
                      __global Tiles *tiles, __global uint *listed, __global uchar *visible, uint count,
                      uint stride)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    visible[i] = 0;
    listed[i] = 0;
    if (!may_be_kept(view, bounds, stride, i, view->limits.depth_growth))
        return;
    Source source = {positions, indices, coverage, f_dc, f_rest};
    FaceLanes projected;
    float depth;
    Box t;
    int kept, seen = project_seen(&i, &source, view, &projected.faces, &t, &depth, &kept);
    visible[i] = kept != 0;
    if (!seen)
        return;
    color_faces(&i, &source, view, projected.faces.color);
    projected.faces.number = (int)numbers[i];
    listed[i] = 1;
    keys[i] = as_uint(depth);
    tiles[i] = (Tiles)(t.x0, t.y0, t.x1, t.y1);
    __global uint *words = (__global uint *)(faces + i);
    for (uint w = 0; w < FACE_WORDS; w++)
        words[w] = projected.words[w];
}
