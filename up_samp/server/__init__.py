"""Planning as a service on this machine: ``up-samp serve`` (extra ``[server]``).

``jobs`` runs each plan in a process of its own with limits, and has requests looked at in one more;
``worker`` is these processes, ``app`` the HTTP interface, ``guard`` what it turns away by its head,
``page.html`` its page. No request reaches a file of the server's disk: maps come inside.
"""
