"""What every small HTTP server of this package shares (room: web; host).

In: requests. Out: answers with a length, sentences instead of tracebacks, bodies within limits.
"""
