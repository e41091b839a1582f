/* The NMPC's solver, the plant's integrator and the closed loop of both.
 *
 * Model and cost come from generated C beside this file, which takes several arguments at once
 * (compiled/lanes.py): `implicit_step` is a linearly implicit step of plant and predictor, taken
 * by several columns of an extrapolation at once; `implicit_slopes` its derivatives,
 * `command_torque` what a command holds over a period and `period_cost` the residuals of a
 * period with their derivatives, for several periods of the horizon at once. The algorithm is
 * that of control/nmpc.py and simulation/plant.py, which state it readably; here it runs without
 * an interpreter. Matrices are row-major, those of the model column-major.
 */
#include <math.h>

typedef void model_function(const double *const *arg, double *const *res);
extern model_function command_torque, implicit_step, implicit_slopes, period_cost;

/* What the model's functions take at once: ABREAST columns, WIDE periods. The cost has so many
 * RESIDUALS for each period. Their derivatives that are not always zero are SLOPES, residual by
 * residual: those of residual r begin at SLOPE_STARTS[r], and slope s is by variable SLOPE_OF[s]
 * of (q after the period, state before it, command, former command). */
#ifndef ABREAST
#error "ABREAST, WIDE, RESIDUALS, SLOPE_STARTS and SLOPE_OF are of the model's generated code"
#endif
static const int slope_starts[] = {SLOPE_STARTS}, slope_of[] = {SLOPE_OF};
#define SLOPES ((int)(sizeof slope_of / sizeof *slope_of))

enum status { CONVERGED, ITERATION_LIMIT, NO_DECREASE, NOT_FINITE };

#define SUFFICIENT_DECREASE 1e-4
#define SHORTEST_STEP 0x1p-12
#define ROUNDING 1e-13 /* of a computed cost */
#define STEADY 0.3 /* a contraction below which the next steps may be foretold ... */
#define NEARLY 100 /* ... once a step is shorter than so many tolerances */

/* How a period is integrated: in `steps` steps, each extrapolated from `columns` columns. */
typedef struct {
    int steps, columns;
    const double *weights; /* of the columns */
    const double *gains;   /* of the inner loop: as the controller believes, or as they are */
} integrator;

typedef struct {
    int segments, horizon, flow_size;
    int max_iterations, real_time;
    double angle_bound, tolerance, period;
    integrator predictor, plant;
    const double *values, *weights; /* of the arm, and of the cost */
    double *work; /* engine_work() doubles, 0 at first */
} engine;

typedef struct {
    const double *state, *previous, *reference, *flow, *disturbance;
} task;

typedef struct {
    double cost, last_step;
    int status, iterations;
} outcome;

/* Pieces of the work array, in order. Those that are `wide` hold WIDE periods side by side:
 * element i of period k, of a piece with `count` elements, is lane(piece, count, k)[i * WIDE]. */
typedef struct {
    double *wide_start, *wide_next, *wide_inputs, *wide_flow, *wide_disturbance;
    double *wide_commands, *wide_command_slopes; /* torques of the commands, by q_bar */
    double *wide_points; /* where each step of the rollout starts, and how the rates change */
    double *wide_a, *wide_b;
    double *wide_former, *wide_reference, *wide_last; /* what else the residuals depend on */
    double *wide_residuals, *wide_slopes;
    double *slope, *rates;  /* of one group of periods: derivatives of a step, n rows */
    double *begun, *chain; /* ... and of what has been gone of the period, 2 n rows */
    double *states;
    double *now, *change, *end; /* of the columns, and of a step */
    double *command, *one_input, *one_command, *one_slope;
    double *motion, *previous_motion, *row; /* derivatives by all inputs */
    double *hessian, *factor, *gradient, *direction, *trial, *residual, *multiplier;
    double *no_disturbance, *previous;
    int *set;
} pieces;

static double *take(double *work, long *used, long count) {
    double *piece = work ? work + *used : 0;
    *used += count;
    return piece;
}

static int groups(const engine *e) { return (e->horizon + WIDE - 1) / WIDE; }

/* Points of a period at which the predictor is differentiated. */
static int points(const engine *e) {
    const integrator *by = &e->predictor;
    return by->steps * by->columns * (by->columns + 1) / 2;
}

static long cut(const engine *e, double *work, pieces *p) {
    long n = e->segments, x = 2 * n, k = e->horizon, size = n * k, used = 0;
    long wide = (long)groups(e) * WIDE, columns = (x + n) * WIDE;
    p->wide_start = take(work, &used, wide * x);
    p->wide_next = take(work, &used, wide * x);
    p->wide_inputs = take(work, &used, wide * n);
    p->wide_flow = take(work, &used, wide * e->flow_size);
    p->wide_disturbance = take(work, &used, wide * n);
    p->wide_commands = take(work, &used, wide * n);
    p->wide_command_slopes = take(work, &used, wide * n * n);
    p->wide_points = take(work, &used, wide * (x + n) * points(e));
    p->wide_a = take(work, &used, wide * x * x);
    p->wide_b = take(work, &used, wide * x * n);
    p->wide_former = take(work, &used, wide * n);
    p->wide_reference = take(work, &used, wide * 2);
    p->wide_last = take(work, &used, wide);
    p->wide_residuals = take(work, &used, wide * RESIDUALS);
    p->wide_slopes = take(work, &used, wide * SLOPES);
    p->slope = take(work, &used, n * columns);
    p->rates = take(work, &used, n * WIDE);
    p->begun = take(work, &used, x * columns);
    p->chain = take(work, &used, x * columns);
    p->states = take(work, &used, (k + 1) * x);
    p->now = take(work, &used, x * ABREAST);
    p->change = take(work, &used, n * ABREAST);
    p->end = take(work, &used, x);
    p->command = take(work, &used, n);
    p->one_input = take(work, &used, n * WIDE);
    p->one_command = take(work, &used, n * WIDE);
    p->one_slope = take(work, &used, n * n * WIDE);
    p->motion = take(work, &used, x * size);
    p->previous_motion = take(work, &used, x * size);
    p->row = take(work, &used, size);
    p->hessian = take(work, &used, size * size);
    p->factor = take(work, &used, size * size);
    p->gradient = take(work, &used, size);
    p->direction = take(work, &used, size);
    p->trial = take(work, &used, size);
    p->residual = take(work, &used, size);
    p->multiplier = take(work, &used, size);
    p->no_disturbance = take(work, &used, n);
    p->previous = take(work, &used, n);
    p->set = (int *)take(work, &used, size);
    return used;
}

long engine_work(const engine *e) {
    pieces p;
    return cut(e, 0, &p);
}

static double *lane(double *wide, int count, int k) {
    return wide + (long)(k / WIDE) * count * WIDE + k % WIDE;
}

static void put(double *wide, int count, int k, const double *values) {
    double *to = lane(wide, count, k);
    for (int i = 0; i < count; i++) to[i * WIDE] = values[i];
}

static void get(double *values, int count, const double *lane_of) {
    for (int i = 0; i < count; i++) values[i] = lane_of[i * WIDE];
}

static double largest(const double *v, int count) {
    double most = 0;
    for (int i = 0; i < count; i++) most = fmax(most, fabs(v[i]));
    return most;
}

/* What is constant over a period. */
typedef struct {
    const double *command, *flow, *disturbance;
} period_inputs;

/* Add the weighted ends of the columns of an extrapolation from x to p->end. Column j goes the
 * length in j steps; the columns go abreast, and the longest first. Where each step starts, and
 * the change of the rates in it, are kept in the lane `point`, if asked for. */
static void extrapolate(const engine *e, const integrator *by, const period_inputs *in, const double *x,
                        double start, double length, pieces *p, double *point) {
    int n = e->segments, size = 2 * n, waiting = by->columns, column[ABREAST], gone[ABREAST];
    double time[ABREAST], step[ABREAST], *now = p->now, *change = p->change;
    const double *arg[] = {now, time, step, in->command, in->flow, in->disturbance, by->gains,
                           e->values};
    double *res[] = {change};
    for (int l = 0; l < ABREAST; l++) column[l] = gone[l] = 0;
    for (;;) {
        int going = 0;
        for (int l = 0; l < ABREAST; l++) {
            if (gone[l] == column[l] && waiting) {
                column[l] = waiting--;
                gone[l] = 0;
                for (int i = 0; i < size; i++) now[i * ABREAST + l] = x[i];
            }
            step[l] = length / (column[l] ? column[l] : 1);
            time[l] = start + (gone[l] + 1) * step[l];
            going += gone[l] < column[l];
        }
        if (!going) return;
        implicit_step(arg, res);
        for (int l = 0; l < ABREAST; l++) {
            if (gone[l] == column[l]) continue;
            if (point) {
                int index = column[l] * (column[l] - 1) / 2 + gone[l];
                double *to = point + (long)index * (size + n) * WIDE;
                for (int i = 0; i < size; i++) to[i * WIDE] = now[i * ABREAST + l];
                for (int i = 0; i < n; i++) to[(size + i) * WIDE] = change[i * ABREAST + l];
            }
            for (int i = 0; i < n; i++) {
                double *q = now + i * ABREAST + l, *rate = q + n * ABREAST;
                *rate += change[i * ABREAST + l];
                *q += step[l] * *rate;
            }
            if (++gone[l] < column[l]) continue;
            double weight = by->weights[column[l] - 1];
            for (int i = 0; i < size; i++) p->end[i] += weight * now[i * ABREAST + l];
        }
    }
}

/* Move x on by a period; for `point` see above. */
static void advance(const engine *e, const integrator *by, const period_inputs *in, double *x,
                    pieces *p, double *point) {
    int size = 2 * e->segments, each = by->columns * (by->columns + 1) / 2;
    double length = e->period / by->steps;
    for (int s = 0; s < by->steps; s++) {
        for (int i = 0; i < size; i++) p->end[i] = 0;
        extrapolate(e, by, in, x, s * length - e->period / 2, length, p,
                    point ? point + (long)s * each * (size + e->segments) * WIDE : 0);
        for (int i = 0; i < size; i++) x[i] = p->end[i];
    }
}

/* What a task gives for each period, side by side. */
static void read_task(const engine *e, const task *t, pieces *p) {
    int n = e->segments, f = e->flow_size;
    for (int k = 0; k < e->horizon; k++) {
        put(p->wide_flow, f, k, t->flow + f * k);
        put(p->wide_disturbance, n, k, t->disturbance + n * k);
        put(p->wide_reference, 2, k, t->reference + 2 * k);
        *lane(p->wide_last, 1, k) = k + 1 == e->horizon;
    }
}

static void begin_periods(const engine *e, pieces *p) {
    int n = e->segments;
    for (int k = 0; k < e->horizon; k += WIDE) {
        const double *arg[] = {lane(p->wide_inputs, n, k), e->predictor.gains, e->values};
        double *res[] = {lane(p->wide_commands, n, k), lane(p->wide_command_slopes, n * n, k)};
        command_torque(arg, res);
    }
}

static void end_periods(const engine *e, pieces *p) {
    int n = e->segments, x = 2 * n;
    for (int k = 0; k < e->horizon; k += WIDE) {
        const double *arg[] = {lane(p->wide_start, x, k),    lane(p->wide_next, x, k),
                               lane(p->wide_commands, n, k), lane(p->wide_command_slopes, n * n, k),
                               lane(p->wide_inputs, n, k),   lane(p->wide_former, n, k),
                               lane(p->wide_reference, 2, k), lane(p->wide_last, 1, k),
                               e->weights, e->predictor.gains, e->values};
        double *res[] = {lane(p->wide_residuals, RESIDUALS, k), lane(p->wide_slopes, SLOPES, k)};
        period_cost(arg, res);
    }
}

/* Roll the model out under the inputs; the cost, or NaN where it is not finite. */
static double roll_out(const engine *e, const task *t, const double *inputs, pieces *p) {
    int n = e->segments, x = 2 * n, f = e->flow_size;
    double cost = 0;
    for (int k = 0; k < e->horizon; k++) {
        put(p->wide_inputs, n, k, inputs + n * k);
        put(p->wide_former, n, k, k ? inputs + n * (k - 1) : t->previous);
    }
    begin_periods(e, p);
    for (int i = 0; i < x; i++) p->states[i] = t->state[i];
    for (int k = 0; k < e->horizon; k++) {
        double *from = p->states + x * k, *to = from + x;
        period_inputs in = {p->command, t->flow + f * k, t->disturbance + n * k};
        get(p->command, n, lane(p->wide_commands, n, k));
        for (int i = 0; i < x; i++) to[i] = from[i];
        advance(e, &e->predictor, &in, to, p, lane(p->wide_points, (x + n) * points(e), k));
        put(p->wide_start, x, k, from);
        put(p->wide_next, x, k, to);
    }
    end_periods(e, p);
    for (int k = 0; k < e->horizon; k++) {
        const double *residual = lane(p->wide_residuals, RESIDUALS, k);
        for (int r = 0; r < RESIDUALS; r++) cost += residual[r * WIDE] * residual[r * WIDE];
    }
    return cost;
}

/* Derivatives after a step of length h, from those before it: in p->chain, the columns of the
 * period's first state, then those of the command's torque. */
static void follow_chain(int n, double h, pieces *p) {
    int x = 2 * n;
    for (int c = 0; c < x + n; c++) {
        const double *before = p->chain + (long)c * x * WIDE, *own = p->slope + (long)c * n * WIDE;
        for (int r = 0; r < n; r++) {
            double sum[WIDE];
            for (int l = 0; l < WIDE; l++) sum[l] = c < x ? 0 : own[r * WIDE + l];
            for (int m = 0; m < x; m++) {
                const double *s = p->slope + (m * n + r) * WIDE, *in = before + m * WIDE;
                for (int l = 0; l < WIDE; l++) sum[l] += s[l] * in[l];
            }
            for (int l = 0; l < WIDE; l++) p->rates[r * WIDE + l] = sum[l];
        }
        double *q = p->chain + (long)c * x * WIDE, *rate = q + n * WIDE;
        for (int i = 0; i < n * WIDE; i++) {
            rate[i] = p->rates[i];
            q[i] += h * p->rates[i];
        }
    }
}

/* Derivatives by the inputs from those by their torques, in place: n columns of `rows`. */
static void follow_command(int n, int rows, const double *slope, double *by, double *row) {
    for (int r = 0; r < rows; r++) {
        for (int c = 0; c < n; c++)
            for (int l = 0; l < WIDE; l++) {
                double sum = 0;
                for (int m = 0; m < n; m++)
                    sum += by[(m * rows + r) * WIDE + l] * slope[(c * n + m) * WIDE + l];
                row[c * WIDE + l] = sum;
            }
        for (int c = 0; c < n; c++)
            for (int l = 0; l < WIDE; l++) by[(c * rows + r) * WIDE + l] = row[c * WIDE + l];
    }
}

/* Derivatives of the periods k and on, WIDE of them, of the last rollout. */
static void differentiate(const engine *e, pieces *p, int k) {
    int n = e->segments, x = 2 * n, states = x * x * WIDE, commands = x * n * WIDE;
    const integrator *by = &e->predictor;
    double length = e->period / by->steps;
    double *a = lane(p->wide_a, x * x, k), *b = lane(p->wide_b, x * n, k);
    const double *point = lane(p->wide_points, (x + n) * points(e), k);
    for (int i = 0; i < states; i++) a[i] = 0;
    for (int i = 0; i < commands; i++) b[i] = 0;
    for (int i = 0; i < x; i++)
        for (int l = 0; l < WIDE; l++) a[i * (x + 1) * WIDE + l] = 1;
    for (int s = 0; s < by->steps; s++) {
        for (int i = 0; i < states; i++) p->begun[i] = a[i], a[i] = 0;
        for (int i = 0; i < commands; i++) p->begun[states + i] = b[i], b[i] = 0;
        for (int j = 0; j < by->columns; j++) {
            double h = length / (j + 1);
            for (int i = 0; i < states + commands; i++) p->chain[i] = p->begun[i];
            for (int m = 0; m <= j; m++, point += (x + n) * WIDE) {
                double time = s * length - e->period / 2 + (m + 1) * h;
                const double *arg[] = {point, point + x * WIDE, &time, &h,
                                       lane(p->wide_commands, n, k),
                                       lane(p->wide_flow, e->flow_size, k),
                                       lane(p->wide_disturbance, n, k), by->gains, e->values};
                double *res[] = {p->slope, p->slope + n * x * WIDE};
                implicit_slopes(arg, res);
                follow_chain(n, h, p);
            }
            for (int i = 0; i < states; i++) a[i] += by->weights[j] * p->chain[i];
            for (int i = 0; i < commands; i++) b[i] += by->weights[j] * p->chain[states + i];
        }
    }
    follow_command(n, x, lane(p->wide_command_slopes, n * n, k), b, p->rates);
}

static void add_scaled(double *restrict to, double factor, const double *restrict row, int count) {
    for (int c = 0; c < count; c++) to[c] += factor * row[c];
}

/* Add residual r of period k with its derivatives by all inputs to Hessian and half gradient;
 * motion and previous_motion are the derivatives of the states after and before the period. */
static void add_residual(const engine *e, pieces *p, int k, int r) {
    int n = e->segments, size = n * e->horizon, known = n * k, columns = known + n;
    int start = slope_starts[r], end = slope_starts[r + 1], first = known;
    const double *slope = lane(p->wide_slopes, SLOPES, k);
    double *row = p->row;
    for (int s = start; s < end && first; s++)
        if (slope[s * WIDE] != 0) first = slope_of[s] < 3 * n ? 0 : known - n;
    for (int c = first; c < columns; c++) row[c] = 0;
    for (int s = start; s < end; s++) {
        double factor = slope[s * WIDE];
        int by = slope_of[s];
        if (factor == 0) continue;
        if (by < 3 * n) {
            add_scaled(row, factor, by < n ? p->motion + by * size : p->previous_motion + (by - n) * size,
                       by < n ? columns : known);
        } else if (by < 4 * n) {
            row[known + by - 3 * n] += factor;
        } else if (k) {
            row[known + by - 5 * n] += factor;
        }
    }
    double residual = lane(p->wide_residuals, RESIDUALS, k)[r * WIDE];
    for (int i = first; i < columns; i++) {
        double factor = row[i], *h = p->hessian + i * size;
        if (factor == 0) continue;
        p->gradient[i] += factor * residual;
        add_scaled(h + i, factor, row + i, columns - i);
    }
}

/* Gauss-Newton Hessian (upper triangle) and half the gradient of the last rollout. */
static void condense(const engine *e, pieces *p) {
    int n = e->segments, x = 2 * n, size = n * e->horizon;
    for (int i = 0; i < size * size; i++) p->hessian[i] = 0;
    for (int i = 0; i < size; i++) p->gradient[i] = 0;
    for (int k = 0; k < e->horizon; k++) {
        if (k % WIDE == 0) differentiate(e, p, k);
        const double *a = lane(p->wide_a, x * x, k), *b = lane(p->wide_b, x * n, k);
        int known = n * k;
        double *swap = p->motion;
        p->motion = p->previous_motion;
        p->previous_motion = swap;
        for (int row = 0; row < x; row++) {
            double *out = p->motion + row * size;
            for (int c = 0; c < known; c++) out[c] = 0;
            for (int m = 0; m < x; m++) {
                add_scaled(out, a[(row + x * m) * WIDE], p->previous_motion + m * size, known);
            }
            for (int c = 0; c < n; c++) out[known + c] = b[(row + x * c) * WIDE];
        }
        for (int r = 0; r < RESIDUALS; r++) add_residual(e, p, k, r);
    }
}

/* Cholesky factor U'U of the rows and columns in set, and solution of U'U v = v. */
static void factorise(const double *h, int size, const int *set, int count, double *u) {
    for (int i = 0; i < count; i++)
        for (int c = i; c < count; c++) {
            int row = set[i], column = set[c];
            u[i * count + c] = row < column ? h[row * size + column] : h[column * size + row];
        }
    for (int i = 0; i < count; i++) {
        double *ui = u + i * count, pivot = 1 / sqrt(ui[i]);
        for (int c = i; c < count; c++) ui[c] *= pivot;
        for (int m = i + 1; m < count; m++) {
            add_scaled(u + m * count + m, -ui[m], ui + m, count - m);
        }
    }
}

static void substitute(const double *u, int count, double *v) {
    for (int i = 0; i < count; i++) {
        v[i] /= u[i * count + i];
        for (int c = i + 1; c < count; c++) v[c] -= u[i * count + c] * v[i];
    }
    for (int i = count - 1; i >= 0; i--) {
        for (int c = i + 1; c < count; c++) v[i] -= u[i * count + c] * v[c];
        v[i] /= u[i * count + i];
    }
}

/* Gradient of the quadratic model at d: H d + g, from the upper triangle. */
static void model_gradient(const pieces *p, int size, const double *d, double *out) {
    for (int i = 0; i < size; i++) out[i] = p->gradient[i];
    for (int i = 0; i < size; i++) {
        const double *h = p->hessian + i * size;
        double sum = h[i] * d[i];
        for (int c = i + 1; c < size; c++) {
            sum += h[c] * d[c];
            out[c] += h[c] * d[i];
        }
        out[i] += sum;
    }
}

/* Minimise d'Hd/2 + g'd within low <= inputs + d <= high by a primal active-set
 * method; strictly convex, so it ends. Without an active bound it is one solve. */
static void quadratic_step(const engine *e, const double *inputs, pieces *p) {
    int size = e->segments * e->horizon;
    double *d = p->direction, *target = p->residual, *m = p->multiplier, bound = e->angle_bound;
    int *active = (int *)(p->set + size); /* -1 at the lower bound, 1 at the upper, 0 free */
    for (int i = 0; i < size; i++) d[i] = 0, active[i] = 0;
    for (int round = 0; round < 8 * size; round++) {
        int count = 0;
        for (int i = 0; i < size; i++)
            if (!active[i]) p->set[count++] = i;
        model_gradient(p, size, d, m);
        factorise(p->hessian, size, p->set, count, p->factor);
        for (int i = 0; i < count; i++) target[i] = -m[p->set[i]];
        substitute(p->factor, count, target);
        double reach = 1;
        int blocking = -1;
        for (int i = 0; i < count; i++) {
            int v = p->set[i];
            double to = inputs[v] + d[v] + target[i];
            double room = target[i] > 0 ? bound - inputs[v] - d[v] : -bound - inputs[v] - d[v];
            if (fabs(to) > bound && room / target[i] < reach) reach = room / target[i], blocking = v;
        }
        for (int i = 0; i < count; i++) d[p->set[i]] += reach * target[i];
        if (blocking >= 0) {
            active[blocking] = d[blocking] + inputs[blocking] > 0 ? 1 : -1;
            d[blocking] = active[blocking] * bound - inputs[blocking];
            continue;
        }
        model_gradient(p, size, d, m);
        int release = -1;
        double worst = 1e-12 * (1 + largest(p->gradient, size));
        for (int i = 0; i < size; i++)
            if (active[i] && active[i] * m[i] > worst) worst = active[i] * m[i], release = i;
        if (release < 0) return;
        active[release] = 0;
    }
}

static int is_finite(double value) { return value - value == 0; }

void nmpc_solve(const engine *e, const task *t, double *inputs, outcome *out) {
    int size = e->segments * e->horizon;
    pieces p;
    cut(e, e->work, &p);
    read_task(e, t, &p);
    for (int i = 0; i < size; i++) inputs[i] = fmin(fmax(inputs[i], -e->angle_bound), e->angle_bound);
    double cost = roll_out(e, t, inputs, &p);
    out->iterations = 0;
    out->last_step = INFINITY;
    out->cost = cost;
    out->status = NOT_FINITE;
    if (!is_finite(cost)) return;
    out->status = ITERATION_LIMIT;
    double contraction = INFINITY; /* unknown */
    while (out->iterations < e->max_iterations) {
        condense(e, &p);
        quadratic_step(e, inputs, &p);
        double slope = 0, length = largest(p.direction, size), scale = 1;
        for (int i = 0; i < size; i++) slope += 2 * p.gradient[i] * p.direction[i];
        if (out->iterations) contraction = length / out->last_step;
        out->iterations++;
        out->last_step = length;
        /* Convergence is linear: what follows this step is a geometric series. */
        int steady = contraction < STEADY && length < NEARLY * e->tolerance &&
                     length * contraction < (1 - contraction) * e->tolerance;
        int short_enough = length < e->tolerance || steady;
        /* Real-time iteration takes its full steps, converged or not. */
        if (e->real_time ? out->iterations == e->max_iterations : short_enough) {
            /* The model of the cost is exact to third order in so short a step. */
            for (int i = 0; i < size; i++) inputs[i] += p.direction[i];
            out->cost = cost + slope / 2;
            if (short_enough) out->status = CONVERGED;
            return;
        }
        double found;
        for (;;) {
            for (int i = 0; i < size; i++) p.trial[i] = inputs[i] + scale * p.direction[i];
            found = roll_out(e, t, p.trial, &p);
            if (e->real_time ? is_finite(found)
                             : found <= (1 + ROUNDING) * cost + SUFFICIENT_DECREASE * scale * slope)
                break;
            scale /= 2;
            if (scale < (e->real_time ? 1 : SHORTEST_STEP)) {
                out->status = NO_DECREASE;
                return;
            }
        }
        for (int i = 0; i < size; i++) inputs[i] = p.trial[i];
        out->cost = cost = found;
        out->last_step = scale * length;
    }
}

/* One period of the plant. */
void plant_advance(const engine *e, const double *state, const double *q_bar, const double *flow,
                   double *end) {
    pieces p;
    cut(e, e->work, &p);
    put(p.one_input, e->segments, 0, q_bar);
    const double *arg[] = {p.one_input, e->plant.gains, e->values};
    double *res[] = {p.one_command, p.one_slope};
    command_torque(arg, res);
    get(p.command, e->segments, p.one_command);
    period_inputs in = {p.command, flow, p.no_disturbance};
    for (int i = 0; i < 2 * e->segments; i++) end[i] = state[i];
    advance(e, &e->plant, &in, end, &p, 0);
}

/* The plant under commands that are given. */
void plant_follow(const engine *e, int steps, const double *q_bar, const double *sea, double *states) {
    int n = e->segments, x = 2 * n;
    for (int s = 0; s < steps; s++)
        plant_advance(e, states + x * s, q_bar + n * s, sea + e->flow_size * s, states + x * (s + 1));
}

/* A closed loop: solve, apply, move on. Returns the number of steps done; it ends early
 * only where a plan is not finite, which the caller's fallback has to handle. */
int closed_loop(const engine *e, int steps, const double *targets, const double *sea,
                const double *forecast, const double *disturbance, double *plan, double *states,
                double *q_bar, int *statuses, int *iterations) {
    int n = e->segments, x = 2 * n, size = n * e->horizon;
    pieces p;
    cut(e, e->work, &p);
    for (int i = 0; i < n; i++) p.previous[i] = plan[i];
    for (int s = 0; s < steps; s++) {
        task t = {states + x * s, p.previous, targets + 2 * (s + 1), forecast + e->flow_size * s,
                  disturbance + (long)size * s};
        outcome out;
        nmpc_solve(e, &t, plan, &out);
        statuses[s] = out.status;
        iterations[s] = out.iterations;
        if (out.status == NOT_FINITE) return s;
        for (int i = 0; i < n; i++) q_bar[n * s + i] = p.previous[i] = plan[i];
        plant_advance(e, states + x * s, p.previous, sea + e->flow_size * s, states + x * (s + 1));
        for (int i = 0; i < size - n; i++) plan[i] = plan[i + n];
    }
    return steps;
}
