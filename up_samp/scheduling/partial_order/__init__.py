"""What a schedule's times may become while its decisions stay: a partial order of its activities.

``orders_of`` reads off a problem and a schedule of it which differences between points in time keep
every constraint; ``Earliest`` gives all points their earliest times under such differences.
"""

from up_samp.scheduling.partial_order.differences import Difference, Earliest, Planned, Point
from up_samp.scheduling.partial_order.orders import OrderConstraint, orders_of

__all__ = ["Difference", "Earliest", "OrderConstraint", "Planned", "Point", "orders_of"]
