"""What OpenSim makes of a model file, told as JSON: a process of its own, since its library ends the one it is in when
something goes wrong.

    python opensim_places.py MODEL.osim COORDINATES.json    coordinates: {"names": [...], "values": [[...], ...]}
"""

import json
import sys

import opensim  # pyright: ignore[reportMissingImports]


def main() -> None:
    """Prints {"mass": kg, "markers": [{name: [x, y, z]}, one per row]}."""
    opensim.Logger.setLevelString("Error")
    given = json.loads(open(sys.argv[2]).read())
    model = opensim.Model(sys.argv[1])
    state = model.initSystem()
    markers = []
    for row in given["values"]:
        for name, value in zip(given["names"], row, strict=True):
            coordinate = model.getCoordinateSet().get(name)
            coordinate.setClamped(state, False)
            coordinate.setValue(state, value, False)
        model.realizePosition(state)
        found = {}
        for k in range(model.getMarkerSet().getSize()):
            marker = model.getMarkerSet().get(k)
            place = marker.getLocationInGround(state)
            found[marker.getName()] = [place.get(i) for i in range(3)]
        markers.append(found)
    sys.stdout.write(json.dumps({"mass": model.getTotalMass(state), "markers": markers}) + "\n")


if __name__ == "__main__":
    main()
