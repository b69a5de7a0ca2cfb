/* The plant of the paper's rig with its friction, integrated as ehls_ros/physics does it: what kernel_vs_c.py measures
 * the compiled Python against. Operation by operation the same arithmetic, so that both give the same trajectory. */

#include <math.h>

enum { X, V, PL, XV, FRICTION, ELEMENTS = 3, STATES = FRICTION + ELEMENTS };
enum { U, FD, FD_RATE, XD, VD, TEMPERATURE, START };

static const int MOST_EVENTS = 16;
static const int HALVINGS = 18;
static const int SLOW = 3;
static const int MOST_ITERATIONS = 128;
static const double EVENT_TOLERANCE = 1e-9;

typedef struct {
    double supply_pressure, oil_density, bulk_modulus, discharge_coefficient, valve_area_gradient, leakage_coefficient,
        total_volume, moving_mass, piston_area, arm_length, spring_stiffness, viscous_damping, valve_bandwidth, valve_gain,
        gravity;
} Plant;

typedef struct {
    double coulomb_force, static_force, stribeck_velocity, stribeck_exponent, viscous_coefficient;
    double element_stiffness[ELEMENTS], element_weight[ELEMENTS];
    double attraction_rate;
} Friction;

typedef struct {
    const Plant *plant;
    const Friction *friction;
    const double *inputs;
} Coefficients;

static inline double stribeck_level(double v, const Friction *p)
{
    return p->coulomb_force + (p->static_force - p->coulomb_force)
        * exp(-pow(fabs(v / p->stribeck_velocity), p->stribeck_exponent));
}

static inline double sign(double value)
{
    return value > 0.0 ? 1.0 : (value < 0.0 ? -1.0 : 0.0);
}

static inline double applied_force(double t, const double *y, const Coefficients *c)
{
    const Plant *p = c->plant;
    const double *w = c->inputs;
    const double disturbance = w[FD] + w[FD_RATE] * (t - w[START]);
    return p->piston_area * y[PL] - p->viscous_damping * y[V] - p->spring_stiffness * y[X] - p->moving_mass * p->gravity
        - disturbance + 0.0;
}

static inline double evaluate(double t, const double *y, const double *mode, const Coefficients *c, double *rate)
{
    const Plant *p = c->plant;
    const Friction *f = c->friction;
    const double v = y[V];
    const double level = stribeck_level(v, f);
    const double applied = applied_force(t, y, c);
    double friction = f->viscous_coefficient * v;
    for (int i = 0; i < ELEMENTS; i++)
        friction += y[FRICTION + i];

    const double drop = p->supply_pressure - mode[0] * y[PL];
    const double root = sqrt(fabs(drop) / p->oil_density);
    const double flow = p->discharge_coefficient * p->valve_area_gradient * y[XV] * copysign(root, drop);
    const double stored = flow - p->piston_area * v - p->leakage_coefficient * y[PL] - 0.0;

    rate[X] = v;
    rate[V] = (applied - friction) / p->moving_mass;
    rate[PL] = 4.0 * p->bulk_modulus / p->total_volume * stored;
    rate[XV] = p->valve_bandwidth * (p->valve_gain * c->inputs[U] - y[XV]);

    const double direction = sign(v);
    const double relative = 1.0 / level;
    double largest = -mode[0] * y[XV];
    for (int i = 0; i < ELEMENTS; i++) {
        const double F = y[FRICTION + i], side = mode[1 + i];
        double value;
        if (side == 0.0) {
            rate[FRICTION + i] = f->element_stiffness[i] * v;
            value = direction * F - f->element_weight[i] * level;
        } else {
            rate[FRICTION + i] = f->attraction_rate * (side * f->element_weight[i] - F * relative);
            value = -side * v;
        }
        largest = value > largest ? value : largest;
    }
    return largest;
}

static void change(const double *y, double *mode, const Coefficients *c)
{
    const Friction *f = c->friction;
    if (-mode[0] * y[XV] > 0.0)
        mode[0] = -mode[0];
    const double v = y[V], level = stribeck_level(v, f), direction = sign(v);
    for (int i = 0; i < ELEMENTS; i++) {
        if (mode[1 + i] == 0.0) {
            if (direction * y[FRICTION + i] - f->element_weight[i] * level > 0.0)
                mode[1 + i] = direction;
        } else if (mode[1 + i] * v < 0.0) {
            mode[1 + i] = 0.0;
        }
    }
}

typedef struct {
    double end[STATES], stage[STATES], k1[STATES], k2[STATES], k3[STATES], k4[STATES], k5[STATES], k6[STATES];
} Work;

static inline void take_step(double t, const double *y, const double *mode, const Coefficients *c, double step, Work *w)
{
    const double *k1 = w->k1, *k2 = w->k2, *k3 = w->k3, *k4 = w->k4, *k5 = w->k5, *k6 = w->k6;
    for (int i = 0; i < STATES; i++)
        w->stage[i] = y[i] + step * (1.0 / 5 * k1[i]);
    evaluate(t + 1.0 / 5 * step, w->stage, mode, c, w->k2);
    for (int i = 0; i < STATES; i++)
        w->stage[i] = y[i] + step * (3.0 / 40 * k1[i] + 9.0 / 40 * k2[i]);
    evaluate(t + 3.0 / 10 * step, w->stage, mode, c, w->k3);
    for (int i = 0; i < STATES; i++)
        w->stage[i] = y[i] + step * (44.0 / 45 * k1[i] - 56.0 / 15 * k2[i] + 32.0 / 9 * k3[i]);
    evaluate(t + 4.0 / 5 * step, w->stage, mode, c, w->k4);
    for (int i = 0; i < STATES; i++)
        w->stage[i] = y[i]
            + step * (19372.0 / 6561 * k1[i] - 25360.0 / 2187 * k2[i] + 64448.0 / 6561 * k3[i] - 212.0 / 729 * k4[i]);
    evaluate(t + 8.0 / 9 * step, w->stage, mode, c, w->k5);
    for (int i = 0; i < STATES; i++)
        w->stage[i] = y[i]
            + step * (9017.0 / 3168 * k1[i] - 355.0 / 33 * k2[i] + 46732.0 / 5247 * k3[i] + 49.0 / 176 * k4[i]
                - 5103.0 / 18656 * k5[i]);
    evaluate(t + step, w->stage, mode, c, w->k6);
    for (int i = 0; i < STATES; i++)
        w->end[i] = y[i]
            + step * (35.0 / 384 * k1[i] + 500.0 / 1113 * k3[i] + 125.0 / 192 * k4[i] - 2187.0 / 6784 * k5[i]
                + 11.0 / 84 * k6[i]);
}

static double foresee(
    double t, const double *y, const double *mode, const Coefficients *c, double step, Work *w, const double *end_rate)
{
    double between[STATES], rate[STATES], early = 0.0, late = 1.0;
    for (int halving = 0; halving < HALVINGS; halving++) {
        const double s = 0.5 * (early + late);
        for (int i = 0; i < STATES; i++) {
            const double outer = y[i] + s * s * (3.0 - 2.0 * s) * (w->end[i] - y[i]), rise = s * (1.0 - s) * step;
            between[i] = outer + rise * ((1.0 - s) * w->k1[i] - s * end_rate[i]);
        }
        if (evaluate(t + s * step, between, mode, c, rate) > 0.0)
            late = s;
        else
            early = s;
    }
    return late * step;
}

static double locate(
    double t, const double *y, const double *mode, const Coefficients *c, double step, double after, Work *w)
{
    double past[STATES], end_rate[STATES];
    for (int i = 0; i < STATES; i++) {
        past[i] = w->end[i];
        end_rate[i] = w->k1[i];
    }
    double before = fmin(evaluate(t, y, mode, c, w->k1), 0.0);
    const double foreseen = foresee(t, y, mode, c, step, w, end_rate), error = pow(0.5, HALVINGS) * step;
    double low = 0.0, high = step;
    const double tolerance = EVENT_TOLERANCE * step;
    int side = 0, slow = 0;
    for (int iteration = 0; iteration < MOST_ITERATIONS; iteration++) {
        const double width = high - low;
        if (width <= tolerance)
            break;
        double middle;
        if (iteration < 2) {
            middle = foreseen + (iteration == 0 ? error : -2.0 * error);
        } else if (slow == SLOW) {
            middle = low + 0.5 * width;
            slow = 0;
        } else {
            middle = high - after * width / (after - before);
        }
        middle = fmin(fmax(middle, low + 0.75 * tolerance), high - 0.75 * tolerance);
        take_step(t, y, mode, c, middle, w);
        const double value = evaluate(t + middle, w->end, mode, c, w->stage);
        if (value > 0.0) {
            for (int i = 0; i < STATES; i++)
                past[i] = w->end[i];
            high = middle;
            after = value;
            if (side == 1)
                before *= 0.5;
            side = 1;
        } else {
            low = middle;
            before = value;
            if (side == -1)
                after *= 0.5;
            side = -1;
        }
        slow = high - low > 0.5 * width ? slow + 1 : 0;
    }
    for (int i = 0; i < STATES; i++)
        w->end[i] = past[i];
    return high;
}

static int advance(double t, double *y, double *mode, const Plant *plant, const Friction *friction, const double *inputs,
    double step, long steps)
{
    const Coefficients coefficients = { plant, friction, inputs }, *c = &coefficients;
    Work work, *w = &work;
    int dense = 0, changed = 1;
    for (long index = 0; index < steps; index++) {
        double now = t + (double)index * step, remaining = step;
        int located = 0;
        while (remaining > EVENT_TOLERANCE * step) {
            if (changed && evaluate(now, y, mode, c, w->k1) > 0.0) {
                change(y, mode, c);
                evaluate(now, y, mode, c, w->k1);
            }
            take_step(now, y, mode, c, remaining, w);
            double taken = remaining;
            const double after = evaluate(now + remaining, w->end, mode, c, w->k1);
            changed = after > 0.0;
            if (changed && located < MOST_EVENTS) {
                taken = locate(now, y, mode, c, remaining, after, w);
                located++;
            } else if (changed) {
                dense++;
            }
            for (int i = 0; i < STATES; i++)
                y[i] = w->end[i];
            now += taken;
            remaining -= taken;
        }
    }
    return dense;
}

int run_cycles(double *y, double *mode, const Plant *plant, const Friction *friction, double *inputs,
    const double (*commands)[4], long cycles, double step, long steps)
{
    int dense = 0;
    for (long k = 0; k < cycles; k++) {
        inputs[U] = commands[k][0];
        inputs[FD] = commands[k][1];
        inputs[FD_RATE] = commands[k][2];
        inputs[START] = commands[k][3];
        dense += advance(inputs[START], y, mode, plant, friction, inputs, step, steps);
    }
    return dense;
}
