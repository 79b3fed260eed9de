(a sheet is cut out with an oscillating blade: examples/custom/oscillating.py)
G21 G90
G0 Z5
G0 X5 Y5
G111 X45
G111 Y25
G111 X25 Y35
G111 X5 Y25
G111 Y5
G110
G0 Z10
M30
