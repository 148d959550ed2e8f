#include "loops_back.cl"
