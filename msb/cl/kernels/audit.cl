// The mesh audit for CPUs.
// msb/topology/kernel.py launches these kernels in this order:
//
//   count_corners    number of corners in each block of vertices
//   place_corners    move each corner, with the rest of its face, to its block   } for each round of blocks
//   visit_blocks     edges, fans and duplicates, vertex by vertex                }
//   unite_pairs      components, from the pairs of faces that the visits found
//   measure_faces    areas, and the faces of each component
//   sum_largest      the largest component
//
// All counts are integers and all lists are ordered by number.
// Results therefore do not depend on the number of work-items or on their share of the work.
// Areas are added in the same order as in the NumPy code.

#include "lanes.cl"
#include "audit_types.cl"
#include "audit_partition.cl"
#include "audit_pairs.cl"
#include "audit_small.cl"
#include "audit_large.cl"
#include "audit_blocks.cl"
#include "audit_faces.cl"
