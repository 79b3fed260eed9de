"""A pen plotter for the paths of an SVG file: M, L, C and Z, absolute or relative; in mm."""

from ugrbl_motion import Axis, Group

x = Axis(step=2, direction=5, steps_per_unit=80, speed=150, acceleration=1500)
y = Axis(step=3, direction=6, steps_per_unit=80, speed=150, acceleration=1500, invert=True)
pen = Axis(step=4, direction=7, steps_per_unit=400, speed=20, acceleration=400)  # 0: on paper
plotter = Group(x=x, y=y, pen=pen)
COUNT = {"M": 2, "L": 2, "C": 6, "Z": 0}
for part in open("drawing.svg").read().split(' d="')[1:]:
    path, letter, at, start = part.split('"')[0], "", 0j, 0j
    for old, new in [(one, " %s " % one) for one in "MLCZmlcz"] + [(",", " "), ("-", " -")]:
        path = path.replace(old, new).replace("e -", "e-")
    words = path.split()
    while words:
        letter = words.pop(0) if words[0].isalpha() else {"M": "L", "m": "l"}.get(letter, letter)
        n = [float(words.pop(0)) for _ in range(COUNT[letter.upper()])]
        to = [complex(*n[i : i + 2]) + at * letter.islower() for i in range(0, len(n), 2)]
        if letter in "Mm":
            plotter.move(pen=2)
            plotter.move(x=to[0].real, y=to[0].imag)
            start = to[0]
        for a, b in [(k / 16, 1 - k / 16) for k in range(1, 17)] if letter in "Cc" else ():
            to.append(b**3 * at + 3 * a * b * (b * to[0] + a * to[1]) + a**3 * to[2])
        for place in to[3:] or to or [start]:
            plotter.move(pen=0)
            plotter.move(x=place.real, y=place.imag, speed=80)
        at = to[-1] if to else start
plotter.move(pen=2)
plotter.wait()
