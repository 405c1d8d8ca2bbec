"""Files: atomic writes, safe reading, arrays, videos and figures."""
