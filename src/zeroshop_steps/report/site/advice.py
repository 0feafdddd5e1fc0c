"""What to do next: for each failed or sparse cell, why, and what helps.

The advice depends on the measures that the grade complains about, or on the step that failed and on words of its reason.
"""

from zeroshop_steps.report.site.results_index import Cell

# In causal order: cameras, masks, surface.
BY_MEASURE = {
    "registered_share": "Some photos have no camera: take 20 to 30 photos in a full circle with more overlap, and put the object on a "
    "ground with more texture, such as the printed one.",
    "silhouette_agreement": "The outlines of mesh and masks differ: look at the masks below, and put the object on a ground of other "
    "colours.",
    "outlines_miss_px": "The masks contradict each other, so parts of the object may be missing: look at the masks below, do not move or "
    "touch the object, and put it on a ground with more print.",
    "largest_part_share": "The mesh is in pieces, because too few photos show its thin parts: take more photos from closer and in between.",
    "open_boundary_diameters": "The surface has open borders that photos see: take photos of these sides as well, from lower and from "
    "above.",
    "back_share": "Photos see the back of the surface through holes: take photos of the torn side again, with more overlap.",
    "roughness_deg": "The surface is rough: light the object evenly, hold the camera still, and take sharper or larger photos.",
    "photometric_error": "The photos disagree about colours: avoid highlights, your own shadow and automatic exposure.",
    "displaced_share": "The surface does not agree with the photos, most often because a lid covers a hollow: take photos from steeper "
    "above, into the hollow. If it has no print, put a few dots of marker or powder into it.",
    "assumed_share": "Part of the surface is a guess, most often a lid over a hollow or a plain flat side: put a few dots of marker or "
    "powder on it, and take photos from more sides.",
    "guessed_share": "Photos do not show how deep part of the surface is, most often a plain or dark hollow: put a few dots of marker or "
    "powder into it, and take photos into it, in more light.",
    "f_score_1_percent": "Too much of the surface is off the true one: the distances in the viewer show where.",
    "recall_1_percent": "Part of the true surface is missing or covered: the distances in the viewer, on the true model, show where. "
    "Plain or hollow parts need photos from steeper above, and some print.",
    "normal_error_deg": "The surface is wavy: take more photos, sharper or larger ones, in even light.",
    "largest_error_percent": "Part of the surface is far off the true one, such as a hole, a dent or a lid: the distances in the viewer "
    "show where.",
}
# (beginning of the step's name, words in the reason, advice); the first entry that fits is used.
BY_FAILURE = (
    ("register", "what turns is too little", "The object turned before a background that stands still: move the camera around it instead, "
     "hang a plain cloth behind it, or give masks of the object."),
    ("register", "nearly the same direction", "All photos are from one side: go all around the object."),
    ("register", "do not show one scene", "The photos do not fit together: leave the object where it lies, go around it with the camera, "
     "and take more photos in between, on a ground with more texture."),
    ("register", "images registered", "Too few photos could be registered: put more texture under the object (the printed ground), take "
     "more photos with more overlap, and do not move the object or what lies around it."),
    ("register", "is self-consistent but incorrect", "Cameras were found, but they contradict the masks. Often, faces of the object look "
     "alike: put strong, uneven texture under it, take more photos in between, and check the "
     "masks."),
    ("register", "masks", "Cameras or masks are wrong: check the masks, and leave out those that are."),
    ("register", "are alike;", "All photos show the same: move the camera around the object."),
    ("register", "at least", "There are too few photos: film a full circle, or take 20 to 30 photos."),
    ("register", "no matches", "The network matched no pictures: take more and sharper photos with more overlap, or register by colmap."),
    ("register", "network found no camera", "The photos are too different from those that the network knows: register by colmap."),
    ("register", "", "No reliable cameras were found: take sharper pictures with more overlap, on a ground with more texture."),
    ("segment", "the object moved", "The object was moved while it was filmed, or another thing stands out more: film it again alone, "
     "without touching it or the ground."),
    ("segment", "no object was found", "The object was not found: leave one object alone on the ground, in the middle of the photos, in "
     "other colours than the ground. A part of something larger needs your own masks."),
    ("segment", "", "The masks are not good enough: put the object alone on a ground of other colours, or provide your own masks."),
    ("height", "board", "The printed board could not be used: show all of it, flat and larger, in more photos from all around."),
    ("height", "", "The height was not found: give it in the objects table as height_m, in metres."),
    ("surface", "diverged", "The training diverged, most often because of wrong cameras: check cameras and masks."),
    ("surface", "", "Masks and cameras do not agree on any surface: check both, and take the photos on a ground with more texture."),
    ("finish", "outside the masks", "Mesh and masks do not belong together: check the masks."),
    ("finish", "", "The raw mesh could not be finished: take more photos, and check masks and cameras."),
    ("evaluate", "without cameras", "Take a surface method that uses cameras: its meshes are measured, and graded."),
    ("evaluate", "", "The mesh could not be graded: check masks and cameras."),
    ("synthetic", "", "The scene could not be rendered: correct what the reason says and run again."),
    ("capture", "", "The photos could not be imported: correct what the reason says and run again."),
)  # fmt: skip
UNKNOWN_SCALE = "The mesh has no true size: give the object's height (height_m in the objects table), or show a printed board."
UNFINISHED = "Not finished: the last step done is {last}. Run the same command again to continue."
NOTHING_YET = "Nothing was made yet: correct what is wrong and run the same command again."


def advise(cell: Cell) -> list[str]:
    """Advice for a cell, the most helpful first; none for a good mesh of known scale."""
    if cell.failure:
        return [advise_on_failure(cell.failure.step, cell.failure.reason)]
    if cell.state == "unfinished":
        done = [name for name, made in cell.steps if made]
        return [UNFINISHED.format(last=done[-1]) if done else NOTHING_YET]
    reasons = " ".join(cell.reasons)
    faults = [text for measure, text in BY_MEASURE.items() if f" {measure} is " in reasons]
    if cell.facts["mesh"].get("scale") == "unknown":
        faults.append(UNKNOWN_SCALE)
    # F-score and recall complain about the same places.
    return faults[1:] if faults and faults[0] is BY_MEASURE["f_score_1_percent"] and len(faults) > 1 else faults


def advise_on_failure(step: str, reason: str) -> str:
    """Advice for a step that has failed."""
    for start, words, text in BY_FAILURE:
        if step.startswith(start) and words in reason:
            return text
    return "Correct what the reason above says and run again."
