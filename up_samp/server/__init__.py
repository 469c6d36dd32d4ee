"""Planning as a service on this machine: ``up-samp serve`` (extra ``[server]``).

``jobs`` runs each plan in a process of its own with limits, ``worker`` is that process, ``app`` the
HTTP interface, ``page.html`` its page. No request reaches a file of the server's disk: maps come
inside the request.
"""
