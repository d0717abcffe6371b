#include "wrapper.h"
double *read_ratio_table(const char *path, int64_t *count, char *why, size_t size) { (void)path; (void)count; snprintf(why, size, "not yet"); return NULL; }
