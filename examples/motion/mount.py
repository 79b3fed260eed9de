"""A telescope mount: it turns to a place in the sky, and follows it for an hour."""

import asyncio

from ugrbl_motion import Axis, Group

# Units are seconds of arc: 200 steps, 64 microsteps, a belt of 3 to 1, a worm wheel of 144 teeth.
ARCSEC = 200 * 64 * 3 * 144 / 1_296_000
SIDEREAL = 15.0  # units/s; of the stars 15.041
ra = Axis(step=2, direction=5, steps_per_unit=ARCSEC, speed=7200, acceleration=3600)
dec = Axis(step=3, direction=6, steps_per_unit=ARCSEC, speed=7200, acceleration=3600)
mount = Group(ra=ra, dec=dec)


async def follow(ra_to: float, dec_to: float, seconds: float) -> None:
    mount.move(ra=ra_to, dec=dec_to)
    await mount.moved()
    ra.run(SIDEREAL)
    await asyncio.sleep(seconds)
    mount.stop()
    await mount.moved()


asyncio.run(follow(-54_000, 36_000, 3600))
