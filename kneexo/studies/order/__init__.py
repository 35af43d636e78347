"""Study `order`: the full-order against the reduced-order model of the cylinder."""

from kneexo.studies.order.study import (
    OrderResult as OrderResult,
    OrderSettings as OrderSettings,
    order_study as order_study,
)
