/* The same march as sim_heating/march/frames.py, thermal/frame.py and step.py, written by hand in C: the peer of the benchmark.
 *
 * TR-BDF2 for the heat content, linear elements with the mass shared (SHARE = 1/6), Kirchhoff's variable, Newton to 1e-4 K
 * lane by lane with the same first guesses, eight control points side by side. It is written for speed, not as a copy:
 * evaluation and elimination go in one sweep, what crosses an element is computed once, the explicit part of a step comes
 * from the balance of the step before (no evaluation), properties are polynomials between declared points, and the corners of
 * the ratio-table cell that a lane is in lie beside it. Steps are divided where their error asks for it, as in thermal/frame.py.
 *
 * Compiled by benchmarks/c_peer/build.py, strictly (IEEE, no contraction) and with -Ofast.
 */
#include <math.h>
#include <string.h>

#define L 8
#ifndef WIDTH
#define WIDTH 4 /* lanes of one vector: 256 bits */
#endif
#define PRAGMA(text) _Pragma(#text)
#define SIMD(width) PRAGMA(omp simd simdlen(width))
#define LANES SIMD(WIDTH) for (int l = 0; l < L; l++)
#define VARIABLES 5
#define CORNERS 32
#define PROPERTIES 9

enum { P_SURFACE = 5, H_REF, RECOVERY, Q_ADD };

static const double SIGMA = 5.670374419e-8;
static const double GAMMA = 2.0 - 1.41421356237309504880;
static const double D = 1.0 - 0.5 * 1.41421356237309504880;
static const double W = 0.25 * 1.41421356237309504880;
static const double SHARE = 1.0 / 6.0;
static const double TOLERANCE_K = 1e-4;
static const double COLDEST_K = 1.0;
static const int NEWTON_LIMIT = 25;
static const double BIN_K = 5.0;
static const int BINS = 600;
#define FINEST 1024

typedef double row[L] __attribute__((aligned(32)));

/* A material: segments of one polynomial each, (foot, top, h, c, c', then theta, k, k' a pressure column), and the segment of
 * each bin. A surface: bins of (eps, eps', then H_w, cp, 0 a pressure column). */
typedef struct {
    const double *segments;
    const long *of_bin;
} material;

/* The cell of the ratio table that each lane is in: where it ends (for ever at the edges of the table), foot, reciprocal width,
 * corners. A table is axis lengths, axes, ratios with the last variable fastest. */
typedef struct {
    row low[VARIABLES], high[VARIABLES], foot[VARIABLES], inverse[VARIABLES];
    row corner[CORNERS];
} cell;

typedef struct {
    row t, rate, t_start, m_left, m_right, g;
    row e_left, e_right, theta_left, theta_right, stage_left, stage_right, c_left, c_right;
    row e_start, e_star, star_copy, gain, upper, lower, diagonal, residual, delta;
    row foot, top, right[PROPERTIES], left[PROPERTIES];
    long right_of[L];
    long interface;
} node;

typedef struct {
    row now[CONDITIONS], then[CONDITIONS], middle[CONDITIONS];
    row film[3], recovery[3], added[3], fraction[3], column[3];
    row in_column, surroundings4, back_h, back_t, back_eps, factor_eps;
    row scale, d0, first[VARIABLES], reference[VARIABLES];
    row active, failed, iterations, largest, stage_in, stage_out, energy_in, energy_out;
    row stepping, tolerated, done, per, last_dt, before[5];
    row frame_start[CONDITIONS], frame_end[CONDITIONS];
    row source, slope, back_source, back_slope;
    cell ratio;
    long ratio_table[L], surface_table[L];
    long nodes, pressures, columns, fresh;
    const double *table;
    const material *materials;
    node node[];
} group;

long group_size(long nodes) { return sizeof(group) + nodes * sizeof(node); }

/* Properties ------------------------------------------------------------------------------------------------------- */

static long bin(double t) {
    double scaled = t * (1.0 / BIN_K);
    if (!(scaled > 0.0)) return 0;
    return scaled < BINS ? (long)scaled : BINS - 1;
}

static void gather_lane(const group *G, node *x, const long *offsets, row *into, int l) {
    const material *m = &G->materials[offsets[l]];
    const double *s = m->segments + m->of_bin[bin(x->t[l])] * (5 + 3 * G->pressures);
    x->foot[l] = s[0];
    x->top[l] = s[1];
    for (int k = 0; k < 3; k++) into[k][l] = s[2 + k];
    s += 5 + 3 * (long)G->in_column[l];
    for (int k = 0; k < 6; k++) into[3 + k][l] = s[k];
}

/* At an interface foot and top are those that hold for both materials: the narrower segment. */
static void refresh(const group *G, node *x) {
    int outside = 0;
#pragma omp simd simdlen(WIDTH) reduction(| : outside)
    for (int l = 0; l < L; l++) outside |= !((x->t[l] >= x->foot[l]) & (x->t[l] < x->top[l]));
    if (!outside) return;
    for (int l = 0; l < L; l++) {
        if (x->t[l] >= x->foot[l] && x->t[l] < x->top[l]) continue;
        if (x->interface) {
            gather_lane(G, x, (x - 1)->right_of, x->left, l);
            /* Both polynomials about one foot: move the left one's to where the right one's segment begins. */
            double foot = x->foot[l], top = x->top[l];
            gather_lane(G, x, x->right_of, x->right, l);
            double high = foot > x->foot[l] ? foot : x->foot[l];
            row *p[2] = {x->left, x->right};
            double feet[2] = {foot, x->foot[l]};
            for (int s = 0; s < 2; s++) {
                double d = high - feet[s];
                p[s][0][l] += d * (p[s][1][l] + 0.5 * d * p[s][2][l]);
                p[s][1][l] += d * p[s][2][l];
                for (int k = 3; k < 9; k += 3) {
                    p[s][k][l] += d * (p[s][k + 1][l] + 0.5 * d * p[s][k + 2][l]);
                    p[s][k + 1][l] += d * p[s][k + 2][l];
                }
            }
            x->foot[l] = high;
            x->top[l] = top < x->top[l] ? top : x->top[l];
        } else {
            gather_lane(G, x, x->right_of, x->right, l);
        }
    }
}

static void select_pressure(group *G, int stage) {
    int changed = 0;
    for (int l = 0; l < L; l++) changed |= G->in_column[l] != G->column[stage][l];
    if (!changed) return;
    memcpy(G->in_column, G->column[stage], sizeof(row));
    for (long i = 0; i < G->nodes; i++) LANES G->node[i].foot[l] = 1e30;
}

/* The faces -------------------------------------------------------------------------------------------------------- */

static void surface(group *G, int stage) {
    const node *x = G->node;
    long width = 2 + 3 * G->pressures;
    for (int l = 0; l < L; l++) {
        double wall = x->t[l];
        long j = bin(wall);
        double t = wall - BIN_K * j;
        const double *s = G->table + G->surface_table[l] + j * width;
        double eps = G->factor_eps[l] * (s[0] + t * s[1]), eps_slope = G->factor_eps[l] * s[1];
        double f = G->fraction[stage][l];
        s += 2 + 3 * (long)G->column[stage][l];
        double cp = s[1] + f * (s[4] - s[1]);
        double driving = G->recovery[stage][l] - (s[0] + f * (s[3] - s[0]) + t * cp);
        double cube = wall * wall * wall, excess = cube * wall - G->surroundings4[l];
        G->source[l] = G->film[stage][l] * driving + G->added[stage][l] - eps * SIGMA * excess;
        G->slope[l] = -G->film[stage][l] * cp - SIGMA * (4.0 * eps * cube + eps_slope * excess);
    }
}

static void back(group *G) {
    const node *x = &G->node[G->nodes - 1];
    LANES {
        double inner = x->t[l], ambient = G->back_t[l], emitted = SIGMA * G->back_eps[l];
        double cube = inner * inner * inner, square = ambient * ambient;
        G->back_source[l] = -G->back_h[l] * (inner - ambient) - emitted * (cube * inner - square * square);
        G->back_slope[l] = -G->back_h[l] - 4.0 * emitted * cube;
    }
}

/* One Newton iteration --------------------------------------------------------------------------------------------- */

static inline double integral(double value, double first, double slope, double t) {
    return value + t * (first + 0.5 * slope * t);
}

static inline void solve_row(node *restrict x, const row add, const row entry, const row lower_before, const row upper_before,
                             const row delta_before) {
    LANES {
        double pivot = 1.0 / (x->diagonal[l] - lower_before[l] * upper_before[l]);
        x->upper[l] = entry[l] * pivot;
        x->delta[l] = -(x->residual[l] + add[l] + lower_before[l] * delta_before[l]) * pivot;
    }
}

static const row NONE;

static void eliminate(group *G, const double *fraction, double ddt) {
    long n = G->nodes;
    for (long i = 0; i < n; i++) {
        node *restrict x = &G->node[i];
        const node *before = x - 1;
        row k_left, k_right, across, upper;
        refresh(G, x);
        LANES {
            double f = fraction[l], t = x->t[l] - x->foot[l];
            double c = x->right[1][l] + x->right[2][l] * t;
            double h = integral(x->right[0][l], x->right[1][l], x->right[2][l], t);
            double theta0 = x->right[3][l] + f * (x->right[6][l] - x->right[3][l]);
            double k0 = x->right[4][l] + f * (x->right[7][l] - x->right[4][l]);
            double k1 = x->right[5][l] + f * (x->right[8][l] - x->right[5][l]);
            double theta = integral(theta0, k0, k1, t), k = k0 + k1 * t;
            x->e_left[l] = x->m_left[l] * h;
            x->c_left[l] = x->m_left[l] * c;
            x->e_right[l] = x->m_right[l] * h;
            x->c_right[l] = x->m_right[l] * c;
            x->theta_left[l] = x->theta_right[l] = theta;
            k_left[l] = k_right[l] = k;
        }
        if (x->interface) {
            LANES {
                double f = fraction[l], t = x->t[l] - x->foot[l];
                x->e_left[l] = x->m_left[l] * integral(x->left[0][l], x->left[1][l], x->left[2][l], t);
                x->c_left[l] = x->m_left[l] * (x->left[1][l] + x->left[2][l] * t);
                double theta0 = x->left[3][l] + f * (x->left[6][l] - x->left[3][l]);
                double k0 = x->left[4][l] + f * (x->left[7][l] - x->left[4][l]);
                double k1 = x->left[5][l] + f * (x->left[8][l] - x->left[5][l]);
                x->theta_left[l] = integral(theta0, k0, k1, t);
                k_left[l] = k0 + k1 * t;
            }
        }
        if (i == 0) {
            LANES {
                across[l] = -ddt * G->source[l];
                upper[l] = ddt * G->slope[l];
                x->residual[l] = x->e_left[l] + x->e_right[l] - x->e_star[l] + across[l];
            }
        } else {
            LANES {
                double g = ddt * before->g[l];
                across[l] = g * (before->theta_right[l] - x->theta_left[l]) + SHARE * (x->e_left[l] - before->e_right[l]);
                upper[l] = SHARE * x->c_left[l] - g * k_left[l];
                x->residual[l] = x->e_left[l] + x->e_right[l] - x->e_star[l] - across[l];
            }
        }
        LANES x->lower[l] = SHARE * x->c_right[l] - ddt * x->g[l] * k_right[l];
        if (i == n - 1) LANES x->lower[l] = ddt * G->back_slope[l];
        LANES x->diagonal[l] = x->c_left[l] + x->c_right[l] - upper[l] - x->lower[l];
        if (i == 1) solve_row(&G->node[0], across, upper, NONE, NONE, NONE);
        if (i > 1) solve_row(&G->node[i - 1], across, upper, G->node[i - 2].lower, G->node[i - 2].upper, G->node[i - 2].delta);
    }
    row last;
    LANES last[l] = -ddt * G->back_source[l];
    node *x = &G->node[n - 1];
    solve_row(x, last, NONE, (x - 1)->lower, (x - 1)->upper, (x - 1)->delta);
}

static void update(group *G) {
    row next, largest;
    LANES next[l] = largest[l] = 0.0;
    for (long i = G->nodes - 1; i >= 0; i--) {
        node *restrict x = &G->node[i];
        LANES {
            double delta = x->delta[l] - x->upper[l] * next[l];
            next[l] = delta;
            /* Arithmetic with 1 or 0, exact, instead of a choice: gcc would store through a mask, which is slow. */
            double moves = G->active[l], stays = 1.0 - moves;
            double after = x->t[l] + moves * delta;
            x->t[l] = after > COLDEST_K ? after : COLDEST_K;
            x->stage_left[l] = moves * (x->e_left[l] + x->c_left[l] * delta) + stays * x->stage_left[l];
            x->stage_right[l] = moves * (x->e_right[l] + x->c_right[l] * delta) + stays * x->stage_right[l];
            double size = fabs(delta);
            largest[l] = size <= largest[l] ? largest[l] : size;
        }
        if (i == G->nodes - 1) LANES {
            double moved = -G->back_source[l] - G->back_slope[l] * next[l];
            G->stage_out[l] = G->active[l] > 0.0 ? moved : G->stage_out[l];
        }
    }
    LANES {
        double moved = G->source[l] + G->slope[l] * next[l];
        G->stage_in[l] = G->active[l] > 0.0 ? moved : G->stage_in[l];
        G->largest[l] = largest[l];
    }
}

static void solve_stage(group *G, int stage, double dt) {
    select_pressure(G, stage);
    LANES G->active[l] = G->stepping[l];
    for (int k = 0; k < NEWTON_LIMIT; k++) {
        surface(G, stage);
        back(G);
        eliminate(G, G->fraction[stage], D * dt);
        update(G);
        int left = 0;
        for (int l = 0; l < L; l++) {
            G->iterations[l] += G->active[l];
            if (G->largest[l] < TOLERANCE_K) G->active[l] = 0.0;
            left += G->active[l] > 0.0;
        }
        if (!left) return;
    }
    LANES G->failed[l] += G->active[l];
}

/* One step --------------------------------------------------------------------------------------------------------- */

/* Heat content of a node, shared with its neighbours, of the stage just solved. */
static inline void content(const group *G, long i, row out) {
    const node *x = &G->node[i];
    const double *from_left = i > 0 ? (x - 1)->stage_right : x->stage_left;
    const double *from_right = i < G->nodes - 1 ? (x + 1)->stage_left : x->stage_right;
    LANES {
        double own = x->stage_left[l] + x->stage_right[l];
        out[l] = own + SHARE * (from_right[l] + from_left[l] - own);
    }
}

static void add_energy(group *G, double weight) {
    LANES {
        G->energy_in[l] += weight * G->stage_in[l];
        G->energy_out[l] += weight * G->stage_out[l];
    }
}

/* First step after a jump: heat content, and the gain of one second, at the present temperatures. */
static void start_fresh(group *G) {
    select_pressure(G, 0);
    surface(G, 0);
    back(G);
    eliminate(G, G->fraction[0], 0.0);
    for (long i = 0; i < G->nodes; i++) {
        node *x = &G->node[i];
        LANES {
            x->stage_left[l] = x->e_left[l];
            x->stage_right[l] = x->e_right[l];
            x->gain[l] = 0.0;
        }
        if (i == 0) continue;
        LANES {
            double q = (x - 1)->g[l] * ((x - 1)->theta_right[l] - x->theta_left[l]);
            (x - 1)->gain[l] -= q;
            x->gain[l] += q;
        }
    }
    for (long i = 0; i < G->nodes; i++) content(G, i, G->node[i].e_start);
    LANES {
        G->node[0].gain[l] += G->source[l];
        G->node[G->nodes - 1].gain[l] += G->back_source[l];
        G->stage_in[l] = G->source[l];
        G->stage_out[l] = -G->back_source[l];
    }
}

/* Both stages of a step; what it began with stays as it was (t_start, e_start, gain, rate, before). */
static void solve_step(group *G, double dt) {
    long n = G->nodes;
    if (G->fresh) start_fresh(G);
    const double *rows[] = {G->stage_in, G->stage_out, G->energy_in, G->energy_out, G->failed};
    for (int k = 0; k < 5; k++) memcpy(G->before[k], rows[k], sizeof(row));
    LANES G->per[l] = G->fresh ? D * dt : dt / G->last_dt[l];
    add_energy(G, W * dt);
    for (long i = 0; i < n; i++) {
        node *x = &G->node[i];
        LANES {
            x->e_star[l] = x->e_start[l] + G->per[l] * x->gain[l];
            x->t_start[l] = x->t[l];
            x->t[l] += GAMMA * dt * x->rate[l];
        }
    }
    solve_stage(G, 1, dt);
    add_energy(G, W * dt);
    for (long i = 0; i < n; i++) {
        node *x = &G->node[i];
        row heat_content;
        content(G, i, heat_content);
        LANES {
            x->e_star[l] = x->e_start[l] + (W / D) * (heat_content[l] - x->e_start[l]);
            x->t[l] = x->t_start[l] + (x->t[l] - x->t_start[l]) * (1.0 / GAMMA);
        }
    }
    solve_stage(G, 2, dt);
    add_energy(G, D * dt);
}

static void close_step(group *G, double dt) {
    for (long i = 0; i < G->nodes; i++) {
        node *x = &G->node[i];
        content(G, i, x->e_start);
        LANES {
            x->gain[l] = x->e_start[l] - x->e_star[l];
            x->rate[l] = (x->t[l] - x->t_start[l]) * (1.0 / dt);
        }
    }
    G->fresh = 0;
    LANES G->last_dt[l] = dt;
}

/* Control of the step ---------------------------------------------------------------------------------------------- */

/* Error of the heat content of a node by the embedded formula: 4 w / 3 dt F_n - (E* - E_n) / (3 w) + 2 / 3 (E - E*). */
static inline void content_error(const group *G, long i, row out) {
    const node *x = &G->node[i];
    content(G, i, out);
    LANES out[l] = 4.0 / 3.0 * W / D * G->per[l] * x->gain[l] - (x->e_star[l] - x->e_start[l]) * (1.0 / (3.0 * W)) +
                   2.0 / 3.0 * (out[l] - x->e_star[l]);
}

/* Which lanes tolerate the step; how many of those that took part do not. */
static int judge(group *G, double dt, double tolerance_K, int last) {
    row excess, error;
    LANES G->tolerated[l] = G->stepping[l], excess[l] = 0.0;
    if (last) return 0;
    for (long i = 0; i < G->nodes; i++) {
        const node *x = &G->node[i];
        content_error(G, i, error);
        LANES {
            double over = fabs(error[l]) * x->t[l] - tolerance_K * (x->stage_left[l] + x->stage_right[l]);
            excess[l] = over > excess[l] ? over : excess[l];
        }
    }
    int doubtful = 0;
    for (int l = 0; l < L; l++)
        if (G->stepping[l] > 0.0 && G->before[4][l] == 0.0 && (!(excess[l] <= 0.0) || G->failed[l] > 0.0))
            G->tolerated[l] = 0.0, doubtful++;
    if (!doubtful) return 0;
    /* With E* and the error for E*, Newton's update at the end of the step is the error in temperature. */
    for (long i = 0; i < G->nodes; i++) {
        node *x = &G->node[i];
        content_error(G, i, error);
        LANES x->star_copy[l] = x->e_star[l], x->e_star[l] += error[l];
    }
    surface(G, 2);
    back(G);
    eliminate(G, G->fraction[2], D * dt);
    LANES G->active[l] = 0.0;
    update(G);
    for (long i = 0; i < G->nodes; i++) memcpy(G->node[i].e_star, G->node[i].star_copy, sizeof(row));
    for (int l = 0; l < L; l++)
        if (G->stepping[l] > G->tolerated[l] && G->failed[l] == 0.0 && G->largest[l] <= tolerance_K)
            G->tolerated[l] = 1.0, doubtful--;
    return doubtful;
}

/* Close the step in the lanes that tolerate it, take it back in the others. */
static void settle(group *G, double dt, double end) {
    double *rows[] = {G->stage_in, G->stage_out, G->energy_in, G->energy_out, G->failed};
    for (int l = 0; l < L; l++) {
        if (G->tolerated[l] > 0.0)
            G->done[l] = end;
        else
            for (int k = 0; k < 5; k++) rows[k][l] = G->before[k][l];
    }
    for (long i = 0; i < G->nodes; i++) {
        node *x = &G->node[i];
        row heat_content;
        content(G, i, heat_content);
        for (int l = 0; l < L; l++) {
            if (G->tolerated[l] > 0.0) {
                x->e_start[l] = heat_content[l];
                x->gain[l] = heat_content[l] - x->e_star[l];
                x->rate[l] = (x->t[l] - x->t_start[l]) * (1.0 / dt);
            } else {
                x->t[l] = x->t_start[l];
                if (G->fresh) x->gain[l] *= D;
            }
        }
    }
    /* The gain of a fresh start is that of one second, all others are D times that of the last step. */
    for (int l = 0; l < L; l++)
        if (G->tolerated[l] > 0.0)
            G->last_dt[l] = dt;
        else if (G->fresh)
            G->last_dt[l] = 1.0;
    G->fresh = 0;
}

/* Heating ---------------------------------------------------------------------------------------------------------- */

/* Cell of an axis that holds x; the edge value holds outside. An axis of one value has a cell of no slope. */
static long find_cell(cell *R, int axis, int l, const double *a, long n, double x) {
    if (n == 1) {
        R->low[axis][l] = -1e300, R->high[axis][l] = 1e300, R->foot[axis][l] = R->inverse[axis][l] = 0.0;
        return 0;
    }
    long i = 0;
    while (i < n - 2 && x >= a[i + 1]) i++;
    R->foot[axis][l] = a[i];
    R->low[axis][l] = i > 0 ? a[i] : -1e300;
    R->high[axis][l] = i < n - 2 ? a[i + 1] : 1e300;
    R->inverse[axis][l] = 1.0 / (a[i + 1] - a[i]);
    return i;
}

static void gather_corners(group *G, row *x, int l) {
    cell *R = &G->ratio;
    const double *t = G->table + G->ratio_table[l], *axis = t + VARIABLES;
    long n[VARIABLES], at[VARIABLES], stride[VARIABLES], node = 0;
    for (int a = 0; a < VARIABLES; a++) {
        n[a] = (long)t[a];
        at[a] = find_cell(R, a, l, axis, n[a], x[a][l]);
        axis += n[a];
    }
    stride[VARIABLES - 1] = 1;
    for (int a = VARIABLES - 2; a >= 0; a--) stride[a] = stride[a + 1] * n[a + 1];
    for (int a = 0; a < VARIABLES; a++) node += at[a] * stride[a];
    for (int c = 0; c < CORNERS; c++) {
        long k = node;
        for (int a = 0; a < VARIABLES; a++)
            if ((c >> a & 1) && n[a] > 1) k += stride[a];
        R->corner[c][l] = axis[k];
    }
}

static void heat(group *G, int stage, row *x) {
    cell *R = &G->ratio;
    int outside = 0;
#pragma omp simd simdlen(WIDTH) reduction(| : outside)
    for (int l = 0; l < L; l++)
        for (int a = 0; a < VARIABLES; a++) outside |= !((x[a][l] >= R->low[a][l]) & (x[a][l] < R->high[a][l]));
    if (outside)
        for (int l = 0; l < L; l++) gather_corners(G, x, l);
    row value[CORNERS / 2], f;
    for (int a = VARIABLES - 1, m = CORNERS / 2; a >= 0; a--, m /= 2) {
        LANES {
            double s = (x[a][l] - R->foot[a][l]) * R->inverse[a][l];
            f[l] = s < 0.0 ? 0.0 : s > 1.0 ? 1.0 : s;
        }
        row *from = a == VARIABLES - 1 ? R->corner : value;
        for (int c = 0; c < m; c++) LANES value[c][l] = from[c][l] + f[l] * (from[c + m][l] - from[c][l]);
    }
    LANES {
        double r = value[0][l] * (1.0 + G->scale[l]) + G->d0[l];
        for (int a = 0; a < VARIABLES; a++) r += G->first[a][l] * (x[a][l] - G->reference[a][l]);
        G->film[stage][l] = r * x[H_REF][l];
        G->recovery[stage][l] = x[RECOVERY][l];
        G->added[stage][l] = x[Q_ADD][l];
    }
    const double *log10_p = G->table;
    long last = G->pressures - 1;
    for (int l = 0; l < L; l++) {
        double p = log10(x[P_SURFACE][l] > 1e-30 ? x[P_SURFACE][l] : 1e-30), fraction = 0.0;
        long column = 0;
        if (p >= log10_p[last]) {
            column = last - 1, fraction = 1.0;
        } else if (p > log10_p[0]) {
            while (p >= log10_p[column + 1]) column++;
            fraction = (p - log10_p[column]) / (log10_p[column + 1] - log10_p[column]);
        }
        G->column[stage][l] = (double)column;
        G->fraction[stage][l] = fraction;
    }
}

static void take(row *into, const double *history) {
    for (int c = 0; c < CONDITIONS; c++)
        for (int l = 0; l < L; l++) into[c][l] = history[c];
}

static void hold(group *G) {
    memcpy(G->now, G->then, sizeof G->now);
    row *rows[] = {G->film, G->recovery, G->added, G->fraction, G->column};
    for (int k = 0; k < 5; k++) memcpy(rows[k][0], rows[k][2], sizeof(row));
}

static void solve_interval(group *G, double dt) {
    for (int c = 0; c < CONDITIONS; c++) LANES G->middle[c][l] = G->now[c][l] + GAMMA * (G->then[c][l] - G->now[c][l]);
    heat(G, 1, G->middle);
    heat(G, 2, G->then);
    solve_step(G, dt);
}

/* The parts of a frame as the nodes of a binary tree, in order of time; a lane takes part in those that begin where it stands. */
static void divide(group *G, double dt, double tolerance_K) {
    memcpy(G->frame_start, G->now, sizeof G->now);
    memcpy(G->frame_end, G->then, sizeof G->then);
    LANES G->done[l] = 0.0;
    settle(G, dt, FINEST);
    for (long begin = 0, length = FINEST / 2; begin < FINEST;) {
        double before = begin * (1.0 / FINEST), after = (begin + length) * (1.0 / FINEST), part = dt * (length * (1.0 / FINEST));
        for (int l = 0; l < L; l++) {
            G->stepping[l] = G->done[l] == begin ? 1.0 : 0.0;
            if (G->done[l] != begin) continue;
            for (int c = 0; c < CONDITIONS; c++) {
                double change = G->frame_end[c][l] - G->frame_start[c][l];
                G->now[c][l] = G->frame_start[c][l] + before * change;
                G->then[c][l] = begin + length == FINEST ? G->frame_end[c][l] : G->frame_start[c][l] + after * change;
            }
        }
        solve_interval(G, part);
        int again = judge(G, part, tolerance_K, length == 1);
        settle(G, part, (double)(begin + length));
        if (again) {
            length /= 2;
        } else {
            begin += length;
            length = begin & -begin;
        }
    }
    memcpy(G->then, G->frame_end, sizeof G->then);
    LANES G->stepping[l] = 1.0;
}

/* A group through a flight: ratio and pressure from the conditions, steps divided to a tolerance [K].
 * history: (times, CONDITIONS). */
void march(group *G, const double *time_s, const double *history, long times, double tolerance_K, double *surface_K) {
    take(G->then, history);
    memset(&G->ratio, 0, sizeof G->ratio);
    heat(G, 2, G->then);
    if (surface_K) memcpy(surface_K, G->node[0].t, sizeof(row));
    for (long k = 1; k < times; k++) {
        double dt = time_s[k] - time_s[k - 1];
        hold(G);
        take(G->then, history + k * CONDITIONS);
        solve_interval(G, dt);
        if (judge(G, dt, tolerance_K, 0))
            divide(G, dt, tolerance_K);
        else
            close_step(G, dt);
        if (surface_K) memcpy(surface_K + k * L, G->node[0].t, sizeof(row));
    }
}

/* The same with what the surface takes computed beforehand, in the steps that are given: heating is (times, 2, 5, L), stages 1 and 2 of the step to a time. */
void march_heated(group *G, const double *time_s, const double *heating, long times, double tolerance_K, double *surface_K) {
    (void)tolerance_K;
    row *rows[] = {G->film, G->recovery, G->added, G->column, G->fraction};
    for (int k = 0; k < 5; k++) memcpy(rows[k][2], heating + (5 + k) * L, sizeof(row));
    if (surface_K) memcpy(surface_K, G->node[0].t, sizeof(row));
    for (long k = 1; k < times; k++) {
        const double *h = heating + k * 2 * 5 * L;
        for (int r = 0; r < 5; r++) {
            memcpy(rows[r][0], rows[r][2], sizeof(row));
            memcpy(rows[r][1], h + r * L, sizeof(row));
            memcpy(rows[r][2], h + (5 + r) * L, sizeof(row));
        }
        solve_step(G, time_s[k] - time_s[k - 1]);
        close_step(G, time_s[k] - time_s[k - 1]);
        if (surface_K) memcpy(surface_K + k * L, G->node[0].t, sizeof(row));
    }
}

/* Setting up ------------------------------------------------------------------------------------------------------- */

/* rows: (nodes, 4, L) T, m_left, m_right, g; which: (nodes, 1 + L) interface flag and material to the right;
 * scalars: (17, L) surroundings^4, back h, T, eps, emissivity factor, scale, d0, first derivatives, references;
 * tables: (2, L) offsets of the ratio and surface tables. */
void set_up(group *G, long nodes, long pressures, const double *table, const material *materials, const double *rows,
            const long *which, const double *scalars, const long *tables) {
    memset(G, 0, group_size(nodes));
    G->nodes = nodes, G->pressures = pressures, G->table = table, G->materials = materials, G->fresh = 1;
    LANES G->last_dt[l] = G->stepping[l] = 1.0;
    for (long i = 0; i < nodes; i++) {
        node *x = &G->node[i];
        double *into[] = {x->t, x->m_left, x->m_right, x->g};
        for (int k = 0; k < 4; k++) memcpy(into[k], rows + (i * 4 + k) * L, sizeof(row));
        x->interface = which[i * (1 + L)];
        for (int l = 0; l < L; l++) x->right_of[l] = which[i * (1 + L) + 1 + l];
        LANES x->foot[l] = 1e30;
    }
    double *into[] = {G->surroundings4, G->back_h, G->back_t, G->back_eps, G->factor_eps, G->scale, G->d0};
    for (int k = 0; k < 7; k++) memcpy(into[k], scalars + k * L, sizeof(row));
    memcpy(G->first, scalars + 7 * L, sizeof G->first);
    memcpy(G->reference, scalars + 12 * L, sizeof G->reference);
    memcpy(G->ratio_table, tables, sizeof G->ratio_table);
    memcpy(G->surface_table, tables + L, sizeof G->surface_table);
    LANES G->in_column[l] = -1.0;
}

void energy(const group *G, double *out) {
    memcpy(out, G->energy_in, sizeof(row));
    memcpy(out + L, G->iterations, sizeof(row));
    memcpy(out + 2 * L, G->failed, sizeof(row));
}

void temperatures(const group *G, double *out) {
    for (long i = 0; i < G->nodes; i++) memcpy(out + i * L, G->node[i].t, sizeof(row));
}
