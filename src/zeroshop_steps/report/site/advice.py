"""What to do next: for each failed or sparse cell a sentence or two on why, and what helps.

By measure where the grade says which measures are at fault, else by the step that failed and the words of its reason.
"""

from zeroshop_steps.report.site.results_index import Cell

# In the order of what causes what: cameras before masks before surface. `photos` is for captures of the user's own.
BY_MEASURE = {
    "registered_share": "Not every photo has a camera: take more pictures with more overlap, 20 to 30 on a full circle, and put the object "
    "on a ground with more texture, such as the printed one.",
    "silhouette_agreement": "Outlines of mesh and masks differ: look at the masks below, and put the object on a ground of other colours.",
    "largest_part_share": "The mesh is in pieces: thin parts were seen too rarely; add pictures from closer by and in between.",
    "open_boundary_diameters": "The surface has open borders that photos see: film those sides, too, from lower and from above.",
    "back_share": "Photos see the back of the surface through holes: film the torn side again, with more overlap.",
    "roughness_deg": "The surface is rough: light the object evenly, hold the camera still, and take sharper or larger pictures.",
    "photometric_error": "Photos disagree about colours: avoid shine, shadows of your own and automatic exposure.",
    "displaced_share": "The surface lies off what the photos show, most often a lid over a hollow: film steeper from above into it; "
    "a hollow without any print needs specks, such as a few dots of marker or powder.",
    "assumed_share": "Part of the surface is only a guess, most often a lid over a hollow or a plain flat side: put some print on it, "
    "such as a few dots of marker or powder, and film it from more sides.",
    "f_score_1_percent": "Too much of the surface lies off the true one: look at the distances in the viewer for where.",
    "recall_1_percent": "A part of the true surface is missing or covered: look at the distances on the true model for where. "
    "Plain or hollow parts need pictures from steeper above, and some print on them.",
    "normal_error_deg": "The surface is wavy: more pictures, sharper or larger ones, and even light help.",
}
# (step begins with, words in the reason, advice); the first that fits counts.
BY_FAILURE = (
    ("register", "images registered", "Too few pictures could be placed among the others: put more texture under the object (the printed "
     "ground), take more pictures with more overlap, and keep the object and what lies around it still."),
    ("register", "hangs together but is wrong", "Cameras were found, but they contradict the masks, often because faces of the object look "
     "alike: put strong, uneven texture under it, add pictures in between, and check the masks."),
    ("register", "masks", "Cameras or masks are wrong: check the masks, or leave those out that are."),
    ("register", "alike", "All pictures show the same: move the camera around the object."),
    ("register", "at least", "Too few pictures: film a full circle, or take 20 to 30 photos."),
    ("register", "no matches", "The network matched no pictures: take more and sharper ones with more overlap, or register by colmap."),
    ("register", "network found no camera", "The pictures are too unlike what the network knows: register by colmap."),
    ("register", "", "No cameras that can be trusted: take sharper pictures with more overlap, on a ground with more texture."),
    ("segment", "moved during", "The object was moved while it was filmed: film it again without touching it or the ground."),
    ("segment", "stand", "The object was not found: leave one object alone on the ground, mid-picture, in other colours than its ground."),
    ("segment", "", "The masks are not good enough: put the object alone on a ground of other colours, or give masks of your own."),
    ("height", "board", "The printed board could not be used: show all of it, flat and larger, in more photos from all around."),
    ("height", "", "The height was not found: give it in the objects table as height_m, in metres."),
    ("surface", "diverged", "Training broke down, most often by wrong cameras: look at cameras and masks."),
    ("surface", "", "Masks and cameras do not agree on any surface: look at both; film on a ground with more texture."),
    ("finish", "outside the masks", "Mesh and masks do not belong together: check the masks."),
    ("finish", "", "The raw mesh could not be finished: add pictures, and check masks and cameras."),
    ("evaluate", "", "The mesh could not be judged: check masks and cameras."),
    ("synthetic", "", "The scene could not be rendered: correct what the reason names and run again."),
    ("capture", "", "The pictures could not be taken over: correct what the reason names and run again."),
)  # fmt: skip
UNKNOWN_SCALE = "The mesh has no true size: give the object's height (height_m in the objects table), or show a printed board."
UNFINISHED = "Not finished: the last step done is {last}. Run the same command again; it goes on there."


def advise(cell: Cell) -> list[str]:
    """Sentences, the most helpful first; none for a good mesh of known scale."""
    if cell.failure:
        return [advise_on_failure(cell.failure.step, cell.failure.reason)]
    if cell.state == "unfinished":
        done = [name for name, made in cell.steps if made]
        return [UNFINISHED.format(last=done[-1] if done else "none")]
    reasons = " ".join(cell.reasons)
    faults = [text for measure, text in BY_MEASURE.items() if f" {measure} is " in reasons]
    if cell.facts["mesh"].get("scale") == "unknown":
        faults.append(UNKNOWN_SCALE)
    # F-score and recall complain of the same places.
    return faults[1:] if faults and faults[0] is BY_MEASURE["f_score_1_percent"] and len(faults) > 1 else faults


def advise_on_failure(step: str, reason: str) -> str:
    """What helps where a step has failed."""
    for start, words, text in BY_FAILURE:
        if step.startswith(start) and words in reason:
            return text
    return "Look at the reason above; correct what it names and run again."
