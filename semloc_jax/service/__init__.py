"""A map over HTTP: cars follow it by small differences and upload packed drives (room: service; host).

In: a map file, requests. Out: versions, differences, tiles; uploads that were looked at before they are kept.
"""
