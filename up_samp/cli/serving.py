"""``up-samp serve``: planning as a service on this machine."""

from __future__ import annotations

import argparse

from up_samp.model import UnsupportedError


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``serve``."""
    parser.add_argument("--host", default="127.0.0.1", help="(default: %(default)s)")
    parser.add_argument("--port", type=int, default=8008, metavar="N", help="(default: 8008)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="jobs at the same time")
    parser.add_argument("--queue", type=int, default=8, metavar="N", help="jobs that may wait")
    parser.add_argument(
        "--timeout", type=float, default=600.0, metavar="S", help="longest search, in seconds"
    )
    parser.add_argument(
        "--memory", type=float, default=6.0, metavar="GIB", help="address space of a job"
    )
    parser.add_argument(
        "--allow-host",
        action="append",
        default=[],
        metavar="NAME",
        help="answer requests to this name, too (else: localhost, and what --host names)",
    )
    parser.set_defaults(run=_serve)


def _serve(args: argparse.Namespace) -> int:
    try:
        import uvicorn

        from up_samp.server.app import create_app
        from up_samp.server.jobs import JobQueue, Limits
    except ImportError as error:
        raise UnsupportedError(
            f"the service needs the extra [server] ({error.name} is missing): "
            "pip install fastapi uvicorn"
        ) from error
    limits = Limits(
        running=args.jobs,
        waiting=args.queue,
        seconds=args.timeout,
        memory=round(args.memory * 2**30),
    )
    with JobQueue(limits) as jobs:
        print(f"up-samp serves at http://{args.host}:{args.port}/", flush=True)
        uvicorn.run(
            create_app(jobs, {args.host, *args.allow_host}),
            host=args.host,
            port=args.port,
            log_level="warning",
            limit_concurrency=limits.connections,
        )
    return 0
