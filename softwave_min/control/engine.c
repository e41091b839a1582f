/* The NMPC's solver, the plant's integrator and the closed loop of both.
 *
 * The model comes from generated C beside this file: `predictor_stage` is one control period
 * of the predictor with its derivatives, `plant_step` one linearly implicit step of the
 * plant. The algorithm is that of control/nmpc.py and control/integrator.py, which
 * state it readably; here it runs without an interpreter. Matrices are row-major,
 * those of the model column-major. Nothing but functions of math.h is needed.
 */
#include <math.h>

typedef int model_function(const double **arg, double **res, long long *iw, double *w, int mem);
extern model_function predictor_stage, plant_step;

enum status { CONVERGED, ITERATION_LIMIT, NO_DECREASE, NOT_FINITE };

#define SUFFICIENT_DECREASE 1e-4
#define SHORTEST_STEP 0x1p-12
#define ROUNDING 1e-13 /* of a computed cost */
#define STEADY 0.3 /* a contraction below which the next steps may be foretold ... */
#define NEARLY 100 /* ... once a step is shorter than so many tolerances */
#define MOST_COLUMNS 8

typedef struct {
    int segments, horizon, flow_size;
    int max_iterations, real_time;
    double tip_scale, terminal_scale, step_scale, torque_scale; /* roots of the weights */
    double angle_bound, torque_bound, tolerance; /* a torque bound of 0 is none */
    int plant_steps, plant_columns; /* per period; columns of the extrapolation */
    double period;
    const double *gains, *plant_gains, *values; /* the controller's belief, and the truth */
    double *work;      /* doubles of engine_work() */
    double *model_w;   /* work of the generated functions */
    long long *model_iw;
} engine;

typedef struct {
    const double *state, *previous, *reference, *flow, *disturbance;
} task;

typedef struct {
    double cost, last_step;
    int status, iterations;
} outcome;

/* Pieces of the work array, in order. */
typedef struct {
    double *a, *b, *tips, *tip_jacobian, *states; /* of the current rollout */
    double *torques, *torque_by_state, *torque_by_input;
    double *motion, *previous_motion, *sensitivity;
    double *row;
    double *hessian, *factor, *gradient, *direction, *trial, *residual;
    double *multiplier;
    int *set;
    double *tableau;
} pieces;

static double *take(double **free, int count) {
    double *piece = *free;
    *free += count;
    return piece;
}

static pieces cut(const engine *e, double *work) {
    int n = e->segments, x = 2 * n, k = e->horizon, size = n * k;
    pieces p;
    p.a = take(&work, k * x * x);
    p.b = take(&work, k * x * n);
    p.tips = take(&work, 2 * k);
    p.tip_jacobian = take(&work, k * 2 * n);
    p.states = take(&work, (k + 1) * x);
    p.torques = take(&work, size);
    p.torque_by_state = take(&work, k * n * x);
    p.torque_by_input = take(&work, k * n * n);
    p.row = take(&work, size);
    p.motion = take(&work, x * size);
    p.previous_motion = take(&work, x * size);
    p.sensitivity = take(&work, 2 * k * size);
    p.hessian = take(&work, size * size);
    p.factor = take(&work, size * size);
    p.gradient = take(&work, size);
    p.direction = take(&work, size);
    p.trial = take(&work, size);
    p.residual = take(&work, size);
    p.multiplier = take(&work, size);
    p.set = (int *)take(&work, size);
    p.tableau = take(&work, MOST_COLUMNS * x + x);
    return p;
}

int engine_work(int n, int k) {
    int x = 2 * n, size = n * k;
    return k * (x * x + x * n + 2 + 2 * n + n * x + n * n) + (k + 1) * x + 2 * x * size +
           2 * k * size + 2 * size * size + 8 * size + MOST_COLUMNS * x + x;
}

static double largest(const double *v, int count) {
    double most = 0;
    for (int i = 0; i < count; i++) most = fmax(most, fabs(v[i]));
    return most;
}

static double torque_excess(const engine *e, double torque) {
    if (e->torque_bound == 0 || fabs(torque) <= e->torque_bound) return 0;
    return torque - copysign(e->torque_bound, torque);
}

/* Roll the model out under the inputs; the cost, or NaN where it is not finite. */
static double roll_out(const engine *e, const task *t, const double *inputs, pieces *p) {
    int n = e->segments, x = 2 * n;
    double cost = 0;
    for (int i = 0; i < x; i++) p->states[i] = t->state[i];
    for (int k = 0; k < e->horizon; k++) {
        double *tip = p->tips + 2 * k;
        const double *arg[6 + 64] = {p->states + x * k, inputs + n * k, t->flow + e->flow_size * k,
                                t->disturbance + n * k, e->gains, e->values};
        double *torque = p->torques + n * k;
        double *res[8 + 64] = {p->states + x * (k + 1),
                               p->a + x * x * k,
                               p->b + x * n * k,
                               tip,
                               p->tip_jacobian + 2 * n * k,
                               torque,
                               p->torque_by_state + n * x * k,
                               p->torque_by_input + n * n * k};
        predictor_stage(arg, res, e->model_iw, e->model_w, 0);
        double scale = k + 1 < e->horizon ? e->tip_scale : e->terminal_scale;
        for (int i = 0; i < 2; i++) {
            double error = scale * (tip[i] - t->reference[2 * k + i]);
            cost += error * error;
        }
        const double *before = k ? inputs + n * (k - 1) : t->previous;
        for (int i = 0; i < n; i++) {
            double change = e->step_scale * (inputs[n * k + i] - before[i]);
            double excess = e->torque_scale * torque_excess(e, torque[i]);
            cost += change * change + excess * excess;
        }
    }
    return cost;
}

/* Add a residual with its row of derivatives to Hessian and half gradient. */
static void add_row(pieces *p, int size, int columns, const double *row, double residual) {
    for (int i = 0; i < columns; i++) {
        double factor = row[i], *h = p->hessian + i * size;
        p->gradient[i] += factor * residual;
        for (int c = i; c < columns; c++) h[c] += factor * row[c];
    }
}

/* The torques beyond their bound, period k; motion is still that before the period. */
static void add_torques(const engine *e, pieces *p, int k) {
    int n = e->segments, x = 2 * n, size = n * e->horizon, known = n * k;
    for (int i = 0; i < n; i++) {
        double excess = e->torque_scale * torque_excess(e, p->torques[n * k + i]);
        if (excess == 0) continue;
        for (int c = 0; c < known; c++) p->row[c] = 0;
        for (int m = 0; m < x; m++) {
            double factor = e->torque_scale * p->torque_by_state[n * x * k + i + n * m];
            for (int c = 0; c < known; c++) p->row[c] += factor * p->motion[m * size + c];
        }
        for (int m = 0; m < n; m++)
            p->row[known + m] = e->torque_scale * p->torque_by_input[n * n * k + i + n * m];
        add_row(p, size, known + n, p->row, excess);
    }
}

/* Gauss-Newton Hessian (upper triangle) and half the gradient of the last rollout. */
static void condense(const engine *e, const task *t, const double *inputs, pieces *p) {
    int n = e->segments, x = 2 * n, size = n * e->horizon;
    double r = e->step_scale * e->step_scale;
    for (int i = 0; i < size * size; i++) p->hessian[i] = 0;
    for (int i = 0; i < size; i++) {
        int last = i >= size - n;
        const double *before = i < n ? t->previous : inputs - n;
        p->hessian[i * size + i] = last ? r : 2 * r;
        p->gradient[i] = r * (inputs[i] - before[i]);
        if (!last) {
            p->hessian[i * size + i + n] = -r;
            p->gradient[i] += r * (inputs[i] - inputs[i + n]);
        }
    }
    for (int k = 0; k < e->horizon; k++) {
        const double *a = p->a + x * x * k, *b = p->b + x * n * k, *j = p->tip_jacobian + 2 * n * k;
        int known = n * k, columns = known + n;
        if (e->torque_bound > 0) add_torques(e, p, k);
        double *swap = p->motion;
        p->motion = p->previous_motion;
        p->previous_motion = swap;
        for (int row = 0; row < x; row++) {
            double *out = p->motion + row * size;
            for (int c = 0; c < known; c++) out[c] = 0;
            for (int m = 0; m < x; m++) {
                double factor = a[row + x * m];
                const double *in = p->previous_motion + m * size;
                for (int c = 0; c < known; c++) out[c] += factor * in[c];
            }
            for (int c = 0; c < n; c++) out[known + c] = b[row + x * c];
        }
        double scale = k + 1 < e->horizon ? e->tip_scale : e->terminal_scale;
        for (int row = 0; row < 2; row++) {
            double *g = p->sensitivity + (2 * k + row) * size;
            double error = scale * (p->tips[2 * k + row] - t->reference[2 * k + row]);
            for (int c = 0; c < columns; c++) g[c] = 0;
            for (int m = 0; m < n; m++) {
                double factor = scale * j[row + 2 * m];
                const double *in = p->motion + m * size;
                for (int c = 0; c < columns; c++) g[c] += factor * in[c];
            }
            if (scale > 0) add_row(p, size, columns, g, error);
        }
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
            double factor = ui[m], *um = u + m * count;
            for (int c = m; c < count; c++) um[c] -= factor * ui[c];
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
    pieces p = cut(e, e->work);
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
        condense(e, t, inputs, &p);
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
        if (short_enough || (e->real_time && out->iterations == e->max_iterations)) {
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
            if (found <= (1 + ROUNDING) * cost + SUFFICIENT_DECREASE * scale * slope) break;
            scale /= 2;
            if (scale < SHORTEST_STEP) {
                out->status = NO_DECREASE;
                return;
            }
        }
        for (int i = 0; i < size; i++) inputs[i] = p.trial[i];
        out->cost = cost = found;
        out->last_step = scale * length;
    }
}

/* One period of the plant: linearly implicit Euler steps, extrapolated. */
void plant_advance(const engine *e, const double *state, const double *q_bar, const double *flow,
                   double *end) {
    int x = 2 * e->segments;
    pieces p = cut(e, e->work);
    double macro = e->period / e->plant_steps;
    for (int i = 0; i < x; i++) end[i] = state[i];
    for (int index = 0; index < e->plant_steps; index++) {
        double start = index * macro - e->period / 2;
        for (int j = 0; j < e->plant_columns; j++) {
            double h = macro / (j + 1), *row = p.tableau + j * x, *now = p.tableau + MOST_COLUMNS * x;
            for (int i = 0; i < x; i++) now[i] = end[i];
            for (int m = 0; m <= j; m++) {
                double time = start + (m + 1) * h;
                const double *arg[7 + 64] = {now, q_bar, flow, &time, &h, e->plant_gains, e->values};
                double *res[1 + 64] = {row};
                plant_step(arg, res, e->model_iw, e->model_w, 0);
                for (int i = 0; i < x; i++) now[i] = row[i];
            }
            /* Aitken and Neville: row m becomes the next column's entry. */
            for (int m = j - 1; m >= 0; m--)
                for (int i = 0; i < x; i++) {
                    double finer = p.tableau[(m + 1) * x + i], coarser = p.tableau[m * x + i];
                    double ratio = (j + 1.0) / (m + 1.0);
                    p.tableau[m * x + i] = finer + (finer - coarser) / (ratio - 1);
                }
        }
        for (int i = 0; i < x; i++) end[i] = p.tableau[i];
    }
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
                const double *told, const double *disturbance, double *plan, double *states,
                double *q_bar, int *statuses, int *iterations) {
    int n = e->segments, x = 2 * n, size = n * e->horizon;
    double previous[64];
    for (int i = 0; i < n; i++) previous[i] = plan[i];
    for (int s = 0; s < steps; s++) {
        task t = {states + x * s, previous, targets + 2 * (s + 1), told + e->flow_size * s,
                  disturbance + (long)size * s};
        outcome out;
        nmpc_solve(e, &t, plan, &out);
        statuses[s] = out.status;
        iterations[s] = out.iterations;
        if (out.status == NOT_FINITE) return s;
        for (int i = 0; i < n; i++) q_bar[n * s + i] = previous[i] = plan[i];
        plant_advance(e, states + x * s, previous, sea + e->flow_size * s, states + x * (s + 1));
        for (int i = 0; i < size - n; i++) plan[i] = plan[i + n];
    }
    return steps;
}
