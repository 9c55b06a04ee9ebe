"""Zemax tabular BSDF files by their vendor's description, one pair of directions at a time."""

import math

SMALL = (
    "Source Measured\nSymmetry Asymmetrical\nSpectralContent Monochrome\nScatterType BRDF\nSampleRotation 1\n0\n"
    "AngleOfIncidence 2\n0 60\nScatterAzimuth 3\n0 180 360\nScatterRadial 2\n0 180\n\nMonochrome\nDataBegin\n"
    "TIS 0.5\n1 2\n3 4\n5 6\nTIS 0.5\n1 2\n3 4\n5 6\nDataEnd\n"
)
"""A valid, short file."""


class Zemax:
    """A tabular BSDF file after its vendor's description, looked up one pair of directions at a time."""

    def __init__(self, path):
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        self.word = dict(line.split() for line in lines[:4])
        self.axes, line = [], 4
        for name in ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"):
            keyword, count = lines[line].split()
            self.axes.append([float(angle) for angle in lines[line + 1].split()])
            assert (keyword, int(count)) == (name, len(self.axes[-1]))
            line += 2
        assert lines[line] == ""
        self.channels, self.tis, line = {}, {}, line + 1
        while line < len(lines):
            name, table = lines[line], []
            assert lines[line + 1] == "DataBegin"
            line += 2
            for _ in range(len(self.axes[0]) * len(self.axes[1])):
                word, tis = lines[line].split()
                assert word == "TIS"
                self.tis.setdefault(name, []).append(float(tis))
                table.append(
                    [[float(v) for v in row.split()] for row in lines[line + 1 : line + 1 + len(self.axes[2])]]
                )
                line += 1 + len(self.axes[2])
            assert lines[line] == "DataEnd"
            self.channels[name], line = table, line + 1

    def angles(self, theta_i, phi_i, theta_o, phi_o):
        """Azimuth and radial angle about the specular direction, degrees."""
        t, a, p = math.radians(theta_o), math.radians(phi_o - phi_i), math.radians(theta_i)
        x, y, z = math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)
        # The source lies at +x: tilt the specular direction, at -x, up to the pole.
        x, z = math.cos(p) * x + math.sin(p) * z, -math.sin(p) * x + math.cos(p) * z
        return math.degrees(math.atan2(y, x)) % 360, math.degrees(math.acos(max(-1, min(1, z))))

    def value(self, theta_i, phi_i, theta_o, phi_o, channel):
        azimuth, radial = self.angles(theta_i, phi_i, theta_o, phi_o)
        if self.word["Symmetry"] == "PlaneSymmetrical":
            azimuth = min(azimuth, 360 - azimuth)
        rotations = [*self.axes[0], self.axes[0][0] + 360]
        total = 0.0
        for p, wp in self.weights(rotations, (phi_i - rotations[0]) % 360 + rotations[0]):
            for i, w in self.weights(self.axes[1], theta_i):
                block = self.channels[channel][p % len(self.axes[0]) * len(self.axes[1]) + i]
                for a, wa in self.weights(self.axes[2], azimuth):
                    for r, wr in self.weights(self.axes[3], radial):
                        total += wp * w * wa * wr * block[a][r]
        return total

    @staticmethod
    def weights(nodes, x):
        x = min(max(x, nodes[0]), nodes[-1])
        k = max(0, min(len(nodes) - 2, sum(node <= x for node in nodes) - 1))
        if len(nodes) == 1:
            return [(0, 1.0)]
        share = (x - nodes[k]) / (nodes[k + 1] - nodes[k])
        return [(k, 1 - share), (k + 1, share)]
