"""Drives robots with Nav2 as ``up-samp operate`` tells, over its HTTP interface.

``link`` are the requests, ``driver`` what one robot does when, ``node`` is the node: the only part
that knows ROS. Nothing here imports ``up_samp``.
"""
