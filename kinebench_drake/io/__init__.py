"""Input and output: atomic writes, safe reading, JSON, arrays, videos and figures."""
