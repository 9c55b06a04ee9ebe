"""MERL files by the format's published definition, one pair of directions at a time."""

import math
import struct

SCALES = (1 / 1500, 1.15 / 1500, 1.66 / 1500)


def pair_of_bin(i, j, k):
    """The directions at fractional bin numbers: theta_h = (i/90)² 90, theta_d = j, phi_d = k degrees, phi_h = 0."""
    h, d, p = math.radians((i / 90) ** 2 * 90), math.radians(j), math.radians(k)
    about = (math.sin(d) * math.cos(p), math.sin(d) * math.sin(p), math.cos(d))
    opposite = (-about[0], -about[1], about[2])
    return tuple(
        (math.cos(h) * x + math.sin(h) * z, y, -math.sin(h) * x + math.cos(h) * z) for x, y, z in (about, opposite)
    )


def stored(content, wi, wo, phi_bins=180):
    """What the published reader finds in a file's bytes for light from `wi` seen from `wo`: R, G, B, not scaled."""
    total = [a + b for a, b in zip(wi, wo, strict=True)]
    length = math.sqrt(sum(x * x for x in total))
    half = [x / length for x in total]
    theta_h, phi_h = math.acos(min(1.0, half[2])), math.atan2(half[1], half[0])
    # wi turned by -phi_h about the normal, then by -theta_h about the binormal y.
    x = math.cos(phi_h) * wi[0] + math.sin(phi_h) * wi[1]
    y = -math.sin(phi_h) * wi[0] + math.cos(phi_h) * wi[1]
    x, z = math.cos(theta_h) * x - math.sin(theta_h) * wi[2], math.sin(theta_h) * x + math.cos(theta_h) * wi[2]
    theta_d, phi_d = math.acos(min(1.0, z)), math.atan2(y, x)
    if phi_d < 0:
        phi_d += math.pi if phi_bins == 180 else 2 * math.pi
    row = min(89, int(math.sqrt(theta_h / (math.pi / 2)) * 90))
    column = min(89, int(theta_d / (math.pi / 2) * 90))
    last = min(phi_bins - 1, int(phi_d / math.pi * 180))
    place = last + phi_bins * (column + 90 * row)
    return [struct.unpack_from("<d", content, 12 + 8 * (place + c * 90 * 90 * phi_bins))[0] for c in range(3)]
