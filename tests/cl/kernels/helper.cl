#ifndef SCALE
#define SCALE 2
#endif

float helped(float x)
{
    return SCALE * x + OFFSET;
}
