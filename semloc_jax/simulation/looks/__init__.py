"""What a rendered view looks like: materials, light, weather and lens, drawn anew by a seed (room: simulation; host).

In: RenderedView. Out: pictures as cameras may make them, far beyond the plausible: what learns from them must not
depend on any one look.
"""
