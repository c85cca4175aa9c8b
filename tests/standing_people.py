"""People who stand at places of a recording, named in its recording.toml, and where they were found."""

from hypose.body.default_body import human
from hypose.io.motions.results import load_motion, save_body
from hypose.synthetic.performance import moved


def standing_at(performance, place):
    """The performance with the mean of its root above a place (2,) m."""
    now = performance.root[:, :2].mean(0)
    return moved(performance, 0.0, (place[0] - now[0], place[1] - now[1]))


def name_people(folder, places):
    """Adds everybody to recording.toml, with the template's body and their place (2,) m at the beginning."""
    save_body(human(), folder / "body.npz")
    with (folder / "recording.toml").open("a", encoding="utf-8") as file:
        for name, (x, y) in places.items():
            file.write(f'\n[[person]]\nname = "{name}"\nbody = "body.npz"\nplace = [{x}, {y}]\ntime = 0.0\n')


def where(folder):
    """(2,) m: the mean place of a result's person."""
    return load_motion(folder / "motion.npz").joints[:, 0, :2].mean(0)
