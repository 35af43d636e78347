"""kneexo: a polycentric knee exoskeleton with electro-hydraulic actuator, on Drake.

Subpackages: ``kneexo.systems`` (leaf systems), ``kneexo.diagrams`` (builders) and
``kneexo.analysis``; ``kneexo.parameters`` holds every physical number, ``kneexo.linkage`` the
four-bar mathematics as plain functions.
"""

__version__ = "0.1.0"
