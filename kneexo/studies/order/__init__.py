"""Study `order`: the full-order against the reduced-order model of the cylinder."""

from kneexo.studies.order.study import OrderResult, OrderSettings, order_study

__all__ = ["OrderResult", "OrderSettings", "order_study"]
