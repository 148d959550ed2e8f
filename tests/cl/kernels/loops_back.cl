#include "loops.cl"
