{# The Rosenbrock method, included by model.c. The lines of a sum: each but the last has a plus. #}
{% macro sum_of(factors) %}
{% for factor in factors %}
{% if factor %}
                {{ "u%d[i]" | format(loop.index0) if factor == 1.0 else "(%s * u%d[i])" | format(factor | literal(real), loop.index0) }}{{ " +" if not loop.last }}
{% endif %}
{% endfor %}
{% endmacro %}
/* Factorize diagonal I - J, where I is the identity and J the Jacobian. Write the elements of the
 * triangular factors that are not always zero to a, with the inverse of each pivot. */
static void factorize(const real *jacobian, real diagonal, real *a)
{
{% for statement in functions.factorization %}
{{ statement }}
{% endfor %}
}

/* Replace the right side b of a system of equations by its solution, with a of factorize. */
static void solve(const real *a, real *b)
{
{% for statement in functions.solution %}
{{ statement }}
{% endfor %}
}

/* Integrate over a sample time by the Rosenbrock method RODAS, in substeps that meet the tolerance.
 * *substep is the length of the first substep in s, and becomes that of the next call. Return false
 * if {{ most_substeps }} substeps do not reach the end. */
static bool integrate(const instant *start, real *x, real *substep)
{
    instant at = *start;
    real rate[{{ states }}];
    real jacobian[{{ functions.elimination.entries | length }}];
{% if depends_on_time %}
    real by_time[{{ states }}];
{% endif %}
    real a[{{ functions.elimination.size }}];
    real z[{{ states }}];
{% for _ in method.weights %}
    real u{{ loop.index0 }}[{{ states }}];
{% endfor %}
    real done = {{ zero }}; /* time since the start in s */
    bool moved = true;      /* whether the last substep was good */
    bool finished = false;

    linear_at(&at, rate, jacobian{{ ", by_time" if depends_on_time }});
    at.x = z;
    for (uint16_t count = 0U; count < {{ most_substeps }}U; count++) {
        const real rest = {{ NAME }}_SAMPLE_TIME_S - done;
        const bool last = *substep >= ({{ control.whole | literal(real) }} * rest);
        const real h = last ? rest : minimum(*substep, {{ control.share | literal(real) }} * rest);
        const real per_h = {{ one }} / h;
        real error = {{ zero }};
        real factor = {{ control.most | literal(real) }};
        bool good;

        factorize(jacobian, per_h / {{ method.gamma | literal(real) }}, a);
{% for row in method.state_factors %}
{% set stage = loop.index0 %}
{% if row %}
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
            z[i] = x[i] + (
{{ sum_of(row) }}            );
        }
{% if needs_time %}
        at.t = start->t + (done + ({{ method.nodes[stage] | literal(real) }} * h));
{% endif %}
        rate_at(&at, u{{ stage }});
{% endif %}
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
{% if row %}
            u{{ stage }}[i] += per_h * (
{{ sum_of(method.rate_factors[stage]) }}            );
{% else %}
            u{{ stage }}[i] = rate[i];
{% endif %}
{% if depends_on_time and method.time_factors[stage] %}
            u{{ stage }}[i] += ({{ method.time_factors[stage] | literal(real) }} * h) * by_time[i];
{% endif %}
        }
        solve(a, u{{ stage }});
{% endfor %}
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
            const real scale = {{ error_tolerance | literal(real, "tolerance") }} * ({{ one }} + ((x[i] < {{ zero }}) ? -x[i] : x[i]));
            const real difference =
{{ sum_of(method.error_weights) }}            ;

            z[i] = x[i] + (
{{ sum_of(method.weights) }}            );
            error += ((difference < {{ zero }}) ? -difference : difference) / scale;
        }
        good = (error <= {{ one }}) && are_finite(z, {{ states }}U);
{# Not error > easy: an error of nan must make the next substep shorter. #}
        if (!(error <= {{ control.easy | literal(real) }})) {
            factor = maximum({{ control.least | literal(real) }}, {{ control.safety | literal(real) }} / sqrt{{ real.suffix }}(sqrt{{ real.suffix }}(error)));
        }
        if (!moved) { /* a substep from here has failed, so the next one is not longer */
            factor = minimum(factor, {{ one }});
        }
        if (good && (h < *substep)) { /* the end was near */
            *substep = maximum(*substep, factor * h);
        } else {
            *substep = factor * h;
        }
        *substep = minimum(*substep, {{ NAME }}_SAMPLE_TIME_S);
        moved = good;
        if (good) {
            for (uint16_t i = 0U; i < {{ states }}U; i++) {
                x[i] = z[i];
            }
            done += h;
            finished = last;
        }
        if (finished) {
            break;
        }
        if (good) {
{% if needs_time %}
            at.t = start->t + done;
{% endif %}
            linear_at(&at, rate, jacobian{{ ", by_time" if depends_on_time }});
        }
    }
    return finished;
}

