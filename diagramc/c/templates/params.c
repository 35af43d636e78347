{{ first_line | comment }}
#include "{{ name }}.h"

const {{ name }}_params_t {{ name }}_params = {
{% for leaf, members in leaves.items() %}
    { /* {{ leaf }} */
{% for member in members %}
        {{ "{%s}" | format(member.values | join(", ")) if member.is_array else member.values[0] }}, /* {{ member.name }} */
{% endfor %}
    },
{% endfor %}
{% for letter, values in start.items() %}
    {{ "{" ~ values | join(", ") ~ "}" }} /* initial_{{ letter }} */,
{% endfor %}
{% if not numbers %}
    0
{% endif %}
};

const {{ name }}_manifest_t {{ name }}_manifest = {
{% for member, words in manifest.items() %}
    { /* {{ member }} */
{% for row in words | batch(4) %}
        {{ row | join(", ") }},
{% endfor %}
    },
{% endfor %}
};
{% for table in tables %}

const {{ name }}_real_t {{ name }}_table_{{ loop.index0 }}[{{ table.values | length }}] = {
{% for value in table.values %}
    {{ value | literal(real, "a value of a table") }},
{% endfor %}
};
{% endfor %}
