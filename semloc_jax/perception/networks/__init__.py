"""Small networks of our own: layers, one encoder, weights on disk, ONNX (room: perception; JAX and host).

In: pictures float32[h w 3]. Out: dense maps at a quarter of their resolution; files that others run.
"""
