/* The closed loop of kneexo, written by hand: what a compiled model is measured against.
 *
 * Motor, reduced cylinder and, with a load, the four-bar knee integrated by RK4 between samples;
 * every sample time encoder, Eq. 3-7 and 10, then observer and sliding mode (Eq. 20-27), or PID.
 * SI units. All values come from the scenario: the members of Parameters carry the names of the
 * Context parameters of kneexo, and Python fills them by these names.
 *
 * Not here, because the scenarios that are compared do not use it: ramp of the reference, velocity
 * feedforward of the PID, latency of the bus, full order, variants of the estimator.
 */
#include <math.h>

#define DEGREE 25 /* of the inverse of the rod */
#define TABLE_1 5 /* degree of Eq. 10 */

typedef struct {
    double sample_time_s;
    double motor_speed_limit_rad_s;
    double motor_lag_s;
    double motor_acceleration_limit_rad_s2;
    double motor_gear_ratio;
    double motor_displacement_m3_per_rad;
    double motor_leakage_m3_per_s_pa;
    double cylinder_mean_area_m2;
    double cylinder_total_volume_m3;
    double cylinder_bulk_modulus_pa;
    double cylinder_leakage_m3_per_s_pa;
    double cylinder_mass_kg;
    double cylinder_damping_n_s_per_m;
    double cylinder_stiffness_n_per_m;
    double cylinder_stroke_m;
    double cylinder_start_m;
    double cylinder_start_pa;
    double knee_dead_centre_m;
    double knee_centre;
    double knee_half_width;
    double knee_flexion_min_rad;
    double knee_flexion_max_rad;
    double knee_overshoot_rad;
    double knee_angle[26];
    double knee_encoder[26];
    double knee_arm[26];
    double load_segment_mass_kg;
    double load_centre_of_mass_m;
    double load_thigh_inclination_rad;
    double load_gravity_m_s2;
    double load_knee_torque_n_m;
    double load_disturbance_n;
    double load_disturbance_amplitude_n;
    double load_disturbance_frequency_hz;
    double encoder_resolution_rad; /* 0: not quantized */
    double coordinates_o_a_x_m;
    double coordinates_o_a_y_m;
    double coordinates_o_b_x_m;
    double coordinates_o_b_y_m;
    double coordinates_a_2_m;
    double coordinates_a_3_m;
    double coordinates_a_4_m;
    double coordinates_phi_rad;
    double coordinates_eq6_sign;
    double coordinates_offset_rad;
    double table_1[6];
    double reference_mean_rad;
    double reference_amplitude_rad;
    double reference_frequency_hz;
    double estimator_time_constant_s;
    double controller_lambda_per_s;
    double controller_phi_m_s2;
    double controller_eta_m_s3;
    double controller_stiffness_uncertainty_n_per_m;
    double controller_damping_uncertainty_n_s_per_m;
    double controller_load_rate_uncertainty_n_per_s;
    double controller_area_uncertainty;
    double controller_mass_estimate_kg;
    double controller_gain_ratio;
    double controller_command_limit_rad_s;
    double controller_mean_area_m2;
    double controller_total_volume_m3;
    double controller_bulk_modulus_pa;
    double controller_damping_n_s_per_m;
    double controller_stiffness_n_per_m;
    double controller_gear_ratio;
    double controller_displacement_m3_per_rad;
    double controller_proportional_per_s;
    double controller_integral_per_s2;
    double controller_derivative;
    double controller_filter_s;
    double controller_anti_windup_s;
    double controller_moment_arm_m;
    double controller_speed_gain_rad_per_m;
} Parameters;

static inline double clip(double value, double limit)
{
    return value < -limit ? -limit : value > limit ? limit : value;
}

/* Horner's rule, highest power first. */
static inline double polynomial(const double *coefficients, int degree, double t)
{
    double value = coefficients[0];
    for (int i = 1; i <= degree; i++)
        value = value * t + coefficients[i];
    return value;
}

/* ------------------------------------------------------------------------------- plant */

typedef struct {
    double speed, extension, velocity, pressure;
} State;

typedef struct { /* what the derivatives need, computed once */
    double per_lag, acceleration_limit;
    double pressure_per_speed, pressure_per_velocity, pressure_decay;
    double per_mass, push, damping, stiffness;
    double dead_centre, centre, per_half_width, weight, wave;
    const Parameters *p;
} Plant;

static Plant plant_of(const Parameters *p)
{
    double stiffness = 4.0 * p->cylinder_bulk_modulus_pa / p->cylinder_total_volume_m3;
    return (Plant){
        .per_lag = 1.0 / p->motor_lag_s,
        .acceleration_limit = p->motor_acceleration_limit_rad_s2,
        .pressure_per_speed = stiffness * p->motor_displacement_m3_per_rad / p->motor_gear_ratio,
        .pressure_per_velocity = stiffness * p->cylinder_mean_area_m2,
        .pressure_decay =
            stiffness * (p->motor_leakage_m3_per_s_pa + p->cylinder_leakage_m3_per_s_pa),
        .per_mass = 1.0 / p->cylinder_mass_kg,
        .push = p->cylinder_mean_area_m2 / p->cylinder_mass_kg,
        .damping = p->cylinder_damping_n_s_per_m / p->cylinder_mass_kg,
        .stiffness = p->cylinder_stiffness_n_per_m / p->cylinder_mass_kg,
        .dead_centre = p->knee_dead_centre_m,
        .centre = p->knee_centre,
        .per_half_width = 1.0 / p->knee_half_width,
        .weight = p->load_segment_mass_kg * p->load_gravity_m_s2 * p->load_centre_of_mass_m,
        .wave = 2.0 * M_PI * p->load_disturbance_frequency_hz,
        .p = p,
    };
}

/* Argument of the polynomials of the knee at a rod extension. */
static inline double fit_argument(const Plant *k, double extension)
{
    return (sqrt(k->dead_centre - extension) - k->centre) * k->per_half_width;
}

static inline double load_force(const Plant *k, double t, double extension)
{
    const Parameters *p = k->p;
    double s = fit_argument(k, extension);
    double angle = polynomial(p->knee_angle, DEGREE, s);
    double arm = polynomial(p->knee_arm, DEGREE, s);
    double torque = k->weight * sin(p->load_thigh_inclination_rad - angle) + p->load_knee_torque_n_m;
    double force = torque / arm + p->load_disturbance_n;
    if (p->load_disturbance_amplitude_n != 0.0)
        force += p->load_disturbance_amplitude_n * sin(k->wave * t);
    return force;
}

static inline State derivatives(const Plant *k, int loaded, double t, State x, double command)
{
    State f = {
        .speed = clip((command - x.speed) * k->per_lag, k->acceleration_limit),
        .extension = x.velocity,
        .velocity = k->push * x.pressure - k->damping * x.velocity - k->stiffness * x.extension,
        .pressure = k->pressure_per_speed * x.speed - k->pressure_per_velocity * x.velocity
                    - k->pressure_decay * x.pressure,
    };
    if (loaded)
        f.velocity -= k->per_mass * load_force(k, t, x.extension);
    return f;
}

static inline State along(State x, double h, State f)
{
    return (State){x.speed + h * f.speed, x.extension + h * f.extension,
                   x.velocity + h * f.velocity, x.pressure + h * f.pressure};
}

static inline State rk4(const Plant *k, int loaded, double t, double h, State x, double command)
{
    State k1 = derivatives(k, loaded, t, x, command);
    State k2 = derivatives(k, loaded, t + 0.5 * h, along(x, 0.5 * h, k1), command);
    State k3 = derivatives(k, loaded, t + 0.5 * h, along(x, 0.5 * h, k2), command);
    State k4 = derivatives(k, loaded, t + h, along(x, h, k3), command);
    double w = h / 6.0;
    x.speed += w * (k1.speed + 2.0 * (k2.speed + k3.speed) + k4.speed);
    x.extension += w * (k1.extension + 2.0 * (k2.extension + k3.extension) + k4.extension);
    x.velocity += w * (k1.velocity + 2.0 * (k2.velocity + k3.velocity) + k4.velocity);
    x.pressure += w * (k1.pressure + 2.0 * (k2.pressure + k3.pressure) + k4.pressure);
    return x;
}

/* ------------------------------------------------------------- measurement and reference */

/* Measured knee angle at a rod extension: encoder, then Eq. 3-7. */
static inline double measured_angle(const Parameters *p, double fit)
{
    double reading = polynomial(p->knee_encoder, DEGREE, fit);
    double count = p->encoder_resolution_rad;
    if (count != 0.0)
        reading = floor(reading / count) * count;
    double theta_4 = reading + p->coordinates_offset_rad;
    double c_1 =
        p->coordinates_o_b_x_m - p->coordinates_o_a_x_m + p->coordinates_a_4_m * cos(theta_4);
    double c_2 =
        p->coordinates_o_b_y_m - p->coordinates_o_a_y_m + p->coordinates_a_4_m * sin(theta_4);
    double a_2 = p->coordinates_a_2_m, a_3 = p->coordinates_a_3_m;
    double squares = c_1 * c_1 + c_2 * c_2;
    double cosine = (a_2 * a_2 - a_3 * a_3 - squares) / (2.0 * a_3 * sqrt(squares));
    double theta_3 = atan2(-c_2, -c_1) + p->coordinates_eq6_sign * acos(cosine);
    return remainder(theta_3 + p->coordinates_phi_rad, 2.0 * M_PI);
}

typedef struct {
    double x, v, a, j;
} Motion; /* position and derivatives, of the knee or of the rod */

static inline Motion reference(const Parameters *p, double t)
{
    double w = 2.0 * M_PI * p->reference_frequency_hz;
    double cosine = p->reference_amplitude_rad * cos(w * t);
    double sine = p->reference_amplitude_rad * sin(w * t);
    return (Motion){p->reference_mean_rad - cosine, w * sine, w * w * cosine, -w * w * w * sine};
}

/* Coefficients of the derivative of a polynomial. */
static void differentiate(const double *coefficients, int degree, double *result)
{
    for (int i = 0; i < degree; i++)
        result[i] = (degree - i) * coefficients[i];
}

/* --------------------------------------------------------------------------- controllers */

typedef struct { /* observer and sliding mode: gains, then the state */
    double first[TABLE_1], second[TABLE_1 - 1], third[TABLE_1 - 2];
    double gain_x, gain_v, gain_a;
    double lambda_2, lambda_squared, per_phi, per_b, f_v, f_a, k_v, k_a, k_demand, k_0;
    Motion predicted;
} SlidingMode;

static SlidingMode sliding_mode_of(const Parameters *p, double start)
{
    SlidingMode c;
    differentiate(p->table_1, TABLE_1, c.first);
    differentiate(c.first, TABLE_1 - 1, c.second);
    differentiate(c.second, TABLE_1 - 2, c.third);
    double dt = p->sample_time_s, z = exp(-dt / p->estimator_time_constant_s), y = 1.0 - z;
    c.gain_x = 1.0 - z * z * z;
    c.gain_v = 1.5 * (1.0 - z * z) * y / dt;
    c.gain_a = y * y * y / (dt * dt);
    double mass = p->controller_mass_estimate_kg;
    double hydraulic = 4.0 * p->controller_bulk_modulus_pa * p->controller_mean_area_m2
                       / (mass * p->controller_total_volume_m3);
    c.lambda_2 = 2.0 * p->controller_lambda_per_s;
    c.lambda_squared = p->controller_lambda_per_s * p->controller_lambda_per_s;
    c.per_phi = 1.0 / p->controller_phi_m_s2;
    c.per_b = p->controller_gear_ratio / (hydraulic * p->controller_displacement_m3_per_rad);
    c.f_v = hydraulic * p->controller_mean_area_m2 + p->controller_stiffness_n_per_m / mass;
    c.f_a = p->controller_damping_n_s_per_m / mass;
    c.k_v = p->controller_stiffness_uncertainty_n_per_m / mass
            + p->controller_area_uncertainty * hydraulic * p->controller_mean_area_m2;
    c.k_a = p->controller_damping_uncertainty_n_s_per_m / mass;
    c.k_demand = fabs(1.0 - p->controller_gain_ratio);
    c.k_0 = p->controller_load_rate_uncertainty_n_per_s / mass
            + p->controller_gain_ratio * p->controller_eta_m_s3;
    c.predicted = (Motion){polynomial(p->table_1, TABLE_1, start), 0.0, 0.0, 0.0};
    return c;
}

static inline double sliding_mode(SlidingMode *c, const Parameters *p, double t, double angle)
{
    double dt = p->sample_time_s;
    double innovation = polynomial(p->table_1, TABLE_1, angle) - c->predicted.x;
    double x = c->predicted.x + c->gain_x * innovation;
    double v = c->predicted.v + c->gain_v * innovation;
    double a = c->predicted.a + c->gain_a * innovation;
    c->predicted = (Motion){x + dt * (v + 0.5 * dt * a), v + dt * a, a, 0.0};

    Motion q = reference(p, t);
    double x_1 = polynomial(c->first, TABLE_1 - 1, q.x);
    double x_2 = polynomial(c->second, TABLE_1 - 2, q.x);
    double x_3 = polynomial(c->third, TABLE_1 - 3, q.x);
    double e = x - polynomial(p->table_1, TABLE_1, q.x);
    double e_1 = v - x_1 * q.v;
    double e_2 = a - (x_2 * q.v * q.v + x_1 * q.a);
    double jerk = x_3 * q.v * q.v * q.v + 3.0 * x_2 * q.v * q.a + x_1 * q.j;

    double s = e_2 + c->lambda_2 * e_1 + c->lambda_squared * e;
    double demand = jerk - c->lambda_2 * e_2 - c->lambda_squared * e_1;
    double k = c->k_v * fabs(v) + c->k_a * fabs(a) + c->k_demand * fabs(demand) + c->k_0;
    double command = (demand + c->f_v * v + c->f_a * a - k * clip(s * c->per_phi, 1.0)) * c->per_b;
    return clip(command, p->controller_command_limit_rad_s);
}

typedef struct { /* PID: gains, then the state */
    double share, per_filter, per_rate, per_anti_windup;
    double integral, filtered;
} Pid;

static Pid pid_of(const Parameters *p, double start)
{
    return (Pid){
        .share = 1.0 - exp(-p->sample_time_s / p->controller_filter_s),
        .per_filter = 1.0 / p->controller_filter_s,
        .per_rate = -p->controller_speed_gain_rad_per_m * p->controller_moment_arm_m,
        .per_anti_windup = 1.0 / p->controller_anti_windup_s,
        .integral = 0.0,
        .filtered = reference(p, 0.0).x - start,
    };
}

static inline double pid(Pid *c, const Parameters *p, double t, double angle)
{
    double w = 2.0 * M_PI * p->reference_frequency_hz;
    double error = p->reference_mean_rad - p->reference_amplitude_rad * cos(w * t) - angle;
    c->filtered += c->share * (error - c->filtered);
    double rate = p->controller_proportional_per_s * c->filtered + c->integral
                  + p->controller_derivative * (error - c->filtered) * c->per_filter;
    double command = clip(c->per_rate * rate, p->controller_command_limit_rad_s);
    double excess = command / c->per_rate - rate;
    if (p->controller_integral_per_s2 > 0.0)
        c->integral += p->sample_time_s
                       * (p->controller_integral_per_s2 * error + excess * c->per_anti_windup);
    return command;
}

/* ---------------------------------------------------------------------------------- run */

/* Fills record[samples + 1][2] with extension and pressure before each update. Returns the number
 * of the sample at which the rod or the knee left its range or the state was no number, or -1. */
static inline int run(const Parameters *p, int steps, int samples, double *record, int use_pid,
                      int loaded)
{
    Plant plant = plant_of(p);
    State x = {0.0, p->cylinder_start_m, 0.0, p->cylinder_start_pa};
    double start = measured_angle(p, fit_argument(&plant, x.extension));
    SlidingMode sliding = sliding_mode_of(p, start);
    Pid linear = pid_of(p, start);
    double h = p->sample_time_s / steps;
    for (int sample = 0;; sample++) {
        double t = sample * p->sample_time_s;
        record[2 * sample] = x.extension;
        record[2 * sample + 1] = x.pressure;
        double fit = fit_argument(&plant, x.extension);
        double flexion = polynomial(p->knee_angle, DEGREE, fit);
        int inside = x.extension >= 0.0 && x.extension <= p->cylinder_stroke_m
                     && flexion >= p->knee_flexion_min_rad - p->knee_overshoot_rad
                     && flexion <= p->knee_flexion_max_rad + p->knee_overshoot_rad
                     && isfinite(x.pressure);
        if (!inside)
            return sample;
        if (sample == samples)
            return -1;
        double angle = measured_angle(p, fit);
        double command =
            use_pid ? pid(&linear, p, t, angle) : sliding_mode(&sliding, p, t, angle);
        command = clip(command, p->motor_speed_limit_rad_s);
        for (int i = 0; i < steps; i++)
            x = rk4(&plant, loaded, t + i * h, h, x, command);
    }
}

int closed_loop(const Parameters *p, int use_pid, int loaded, int steps, int samples,
                double *record)
{
    if (use_pid)
        return loaded ? run(p, steps, samples, record, 1, 1) : run(p, steps, samples, record, 1, 0);
    return loaded ? run(p, steps, samples, record, 0, 1) : run(p, steps, samples, record, 0, 0);
}

int parameters_size(void)
{
    return sizeof(Parameters);
}
