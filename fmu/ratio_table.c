/* The heating-ratio table of a control point, from the file that the simulator reads: `# key: value` lines, a line of
   names, one row a node of a full grid, in any order. Packed as the kernel takes it: five axis lengths, the axes one
   after the other, the ratios with the last variable fastest. */

#define _GNU_SOURCE

#include "wrapper.h"

#include <locale.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__APPLE__)
#include <xlocale.h>
#endif
#if defined(_WIN32)
typedef _locale_t Locale;
static Locale plain_locale(void) { return _create_locale(LC_NUMERIC, "C"); }
static void drop_locale(Locale locale) { _free_locale(locale); }
#define strtod_l _strtod_l
#else
typedef locale_t Locale;
static Locale plain_locale(void) { return newlocale(LC_NUMERIC_MASK, "C", (Locale)0); }
static void drop_locale(Locale locale) { freelocale(locale); }
#endif

enum { VARIABLES = 5, RATIO = 5, SIGMA = 6, COLUMNS = 7, NAME = 32 };
static const char *const NAMES[COLUMNS] = {"alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg", "ratio", "sigma"};
static const double LIMITS[COLUMNS] = {180.0, 180.0, 20.0, 180.0, 180.0, 1e3, INFINITY};

typedef struct { double (*rows)[COLUMNS]; size_t count, room; } Rows;
typedef struct { double *values; size_t count; } Axis;

static int by_value(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The next cell of a line without surrounding blanks; false after the last. */
static bool next_cell(char **at, char **cell) {
    if (!*at) return false;
    char *comma = strchr(*at, ','), *end = comma ? comma : *at + strlen(*at);
    *cell = *at + strspn(*at, " \t");
    while (end > *cell && strchr(" \t\r", end[-1])) end--;
    *at = comma ? comma + 1 : NULL;
    *end = 0;
    return true;
}

/* Number in NAMES of each column of the file. */
static int read_names(char *line, int columns[], char *why, size_t size) {
    int count = 0, found = 0;
    for (char *at = line, *cell; next_cell(&at, &cell); count++) {
        int k = 0;
        while (k < COLUMNS && strcmp(cell, NAMES[k]) != 0) k++;
        if (k == COLUMNS) return snprintf(why, size, "unknown column %.*s", NAME, cell), 0;
        if (found & 1 << k) return snprintf(why, size, "two columns %s", NAMES[k]), 0;
        columns[count] = k, found |= 1 << k;
    }
    for (int k = 0; k < SIGMA; k++)
        if (!(found & 1 << k)) return snprintf(why, size, "column %s is missing", NAMES[k]), 0;
    return count;
}

static bool read_row(char *line, int count, const int columns[], Locale locale, double row[], char *why, size_t size) {
    int k = 0;
    for (char *at = line, *cell, *end; next_cell(&at, &cell); k++) {
        if (k == count) return snprintf(why, size, "more cells than column names"), false;
        double value = strtod_l(cell, &end, locale);
        bool number = end > cell && !*end && !strpbrk(cell, "xX") && isfinite(value);
        if (!number || fabs(value) > LIMITS[columns[k]] || (columns[k] == SIGMA && value < 0.0))
            return snprintf(why, size, "%s: \"%.*s\" is not valid", NAMES[columns[k]], NAME, cell), false;
        row[columns[k]] = value;
    }
    if (k < count) return snprintf(why, size, "fewer cells than column names"), false;
    return true;
}

/* Value of a header line with this key, NULL where it has another one. */
static const char *header_value(const char *line, const char *key) {
    line += strspn(line, "# \t");
    size_t length = strlen(key);
    return strncmp(line, key, length) == 0 ? line + length + strspn(line + length, " \t") : NULL;
}

static bool is_name(const char *value, const char *name) {
    size_t length = strcspn(value, " \t\r");
    return length == strlen(name) && strncmp(value, name, length) == 0;
}

/* True where a header line agrees with what the model's ratios are over; `stated` where it names the recovery enthalpy. */
static bool same_basis(const char *line, RatioBasis basis, bool *stated, char *why, size_t size) {
    const char *reference = header_value(line, "reference:"), *recovery = header_value(line, "recovery:");
    if (reference && !is_name(reference, basis.reference))
        return snprintf(why, size, "is over %.*s; this model's ratios are over %s", NAME, reference, basis.reference), false;
    if (recovery && *recovery && *recovery != '\r') *stated = true;
    if (recovery && *stated && !is_name(recovery, basis.recovery))
        return snprintf(why, size, "is reduced with recovery %.*s; this model's ratios with %s", NAME, recovery, basis.recovery), false;
    return true;
}

static bool read_rows(char *text, RatioBasis basis, Rows *all, Locale locale, char *why, size_t size) {
    int columns[COLUMNS], count = 0, number = 0;
    bool stated = false;
    char reason[160] = "";
    for (char *line = text, *next; line; line = next) {
        next = strchr(line, '\n');
        if (next) *next++ = 0;
        number++;
        bool good = true, blank = strspn(line, " \t\r") == strlen(line);
        if (blank && (count == 0 || !next || strspn(next, " \t\r\n") == strlen(next))) continue;
        if (blank) {
            good = (snprintf(reason, sizeof reason, "is blank"), false);
        } else if (line[0] == '#' && count == 0) {
            good = same_basis(line, basis, &stated, reason, sizeof reason);
        } else if (count == 0) {
            good = (count = read_names(line, columns, reason, sizeof reason)) > 0;
        } else {
            if (all->count == all->room) {
                all->room = all->room ? 2 * all->room : 256;
                void *more = realloc(all->rows, all->room * sizeof *all->rows);
                if (!more) return snprintf(why, size, "out of memory"), false;
                all->rows = more;
            }
            good = read_row(line, count, columns, locale, all->rows[all->count++], reason, sizeof reason);
        }
        if (!good) return snprintf(why, size, "row %d: %s", number, reason), false;
    }
    if (all->count == 0) return snprintf(why, size, "has no rows"), false;
    if (stated || strcmp(basis.unstated, basis.recovery) == 0) return true;
    return snprintf(why, size, "states no recovery, which means %s; this model's ratios are reduced with %s", basis.unstated,
                    basis.recovery), false;
}

int64_t table_size(const double *table, int64_t most) {
    int64_t nodes = 1, size = VARIABLES;
    if (most < VARIABLES) return 0;
    for (int k = 0; k < VARIABLES; k++) {
        if (!(table[k] >= 1.0 && table[k] <= (double)most) || table[k] != (double)(int64_t)table[k]) return 0;
        size += (int64_t)table[k];
        if ((nodes *= (int64_t)table[k]) > most) return 0;
    }
    return size + nodes <= most ? size + nodes : 0;
}

static size_t node_of(const Axis *axis, double value) {
    const double *found = bsearch(&value, axis->values, axis->count, sizeof value, by_value);
    return (size_t)(found - axis->values);
}

/* Axes, then ratios, which are not set yet. */
static double *packed_axes(const Rows *all, Axis axes[], int64_t *count, char *why, size_t size) {
    size_t n = all->count, axis_nodes = 0, nodes = 1;
    double *sorted = malloc(n * VARIABLES * sizeof(double));
    if (!sorted) return snprintf(why, size, "out of memory"), NULL;
    for (int k = 0; k < VARIABLES; k++) {
        double *values = sorted + (size_t)k * n;
        for (size_t i = 0; i < n; i++) values[i] = all->rows[i][k];
        qsort(values, n, sizeof *values, by_value);
        axes[k].count = 0;
        for (size_t i = 0; i < n; i++)
            if (i == 0 || values[i] > values[i - 1]) values[axes[k].count++] = values[i];
        axes[k].values = values;
        axis_nodes += axes[k].count;
        nodes = nodes > n ? nodes : nodes * axes[k].count;
    }
    double *table = nodes == n ? malloc((VARIABLES + axis_nodes + nodes) * sizeof(double)) : NULL;
    if (!table) snprintf(why, size, "%zu rows do not fill the grid of their values", n);
    double *at = table ? table + VARIABLES : NULL;
    for (int k = 0; table && k < VARIABLES; k++) {
        table[k] = (double)axes[k].count;
        memcpy(at, axes[k].values, axes[k].count * sizeof(double));
        axes[k].values = at;
        at += axes[k].count;
    }
    free(sorted);
    *count = (int64_t)(VARIABLES + axis_nodes + nodes);
    return table;
}

static double *pack(const Rows *all, int64_t *count, char *why, size_t size) {
    Axis axes[VARIABLES];
    double *table = packed_axes(all, axes, count, why, size);
    if (!table) return NULL;
    double *ratio = axes[VARIABLES - 1].values + axes[VARIABLES - 1].count;
    for (size_t i = 0; i < all->count; i++) ratio[i] = NAN;
    for (size_t i = 0; i < all->count; i++) {
        size_t node = 0;
        for (int k = 0; k < VARIABLES; k++) node = node * axes[k].count + node_of(&axes[k], all->rows[i][k]);
        if (!isnan(ratio[node])) {
            snprintf(why, size, "the node alpha_deg %g, log10_re %g is repeated", all->rows[i][0], all->rows[i][2]);
            free(table);
            return NULL;
        }
        ratio[node] = all->rows[i][RATIO];
    }
    return table;
}

double *read_ratio_table(const char *path, RatioBasis basis, int64_t *count, char *why, size_t size) {
    size_t length;
    char *text = read_file(path, &length), reason[256] = "cannot be read";
    Locale locale = plain_locale();
    Rows all = {NULL, 0, 0};
    double *table = NULL;
    if (text && strlen(text) != length) {
        snprintf(reason, sizeof reason, "is not text");
    } else if (text) {
        bool marked = strncmp(text, "\xef\xbb\xbf", 3) == 0;
        if (read_rows(text + (marked ? 3 : 0), basis, &all, locale, reason, sizeof reason))
            table = pack(&all, count, reason, sizeof reason);
    }
    if (!table) snprintf(why, size, "%.500s: %s", path, reason);
    free(all.rows), free(text), drop_locale(locale);
    return table;
}
