{{ first_line | comment }}
#include "{{ name }}_vectors.h"

const {{ name }}_vector_t {{ name }}_vectors[{{ NAME }}_VECTORS] = {
{% for inputs, outputs in vectors %}
    {{ "{{%s}, {%s}}," | format(inputs | join(", ") or "0", outputs | join(", ") or "0") }}
{% endfor %}
};
