"""Join: the passes of an object that was turned over in between become one set of pictures and cameras.

results/DATASET/OBJECT/su_f/REGISTRATION/cameras           rendered: su_h, and su_h_2, for which the model was turned over
results/DATASET/OBJECT/video_joined/REGISTRATION/cameras   photos: the columns images, images_2 and images_3 of objects.tsv
"""


rule join_captures:
    input:
        captures=plan.of_passes("capture"),
        turned=plan.turned_models,
        film_truths=plan.film_truths,
    output:
        capture=directory(f"{SCENE}/capture"),
    log:
        f"{SCENE}/logs/capture.log",
    wildcard_constraints:
        scene=f"{JOINED_SCENE}|{JOINED_PHOTOS}",
    resources:
        **needs(1000, 10),
    params:
        inputs=given(),
    message:
        "Putting the pictures of all passes of {wildcards.object} side by side"
    shell:
        "python -m zeroshop_steps.join --method captures {params.inputs} --scene {wildcards.scene} --out {output.capture} > {log} 2>&1"


rule join_passes:
    input:
        cameras=plan.of_passes("{registration}/cameras"),
    output:
        cameras=directory(f"{RUN}/cameras"),
    log:
        f"{RUN}/logs/join.log",
    wildcard_constraints:
        scene=f"{JOINED_SCENE}|{JOINED_PHOTOS}",
    threads: 2
    resources:
        **needs(3000, 30),
    params:
        options=step_options({"weights": settings["register"]["aliked"]["weights"], "seed": settings["seed"]}),
        weights=plan.weights_stamp("register", methods.REGISTRATIONS["aliked"]),
    message:
        "Joining the passes of {wildcards.object}, {wildcards.registration}"
    shell:
        "python -m zeroshop_steps.join --method passes --cameras {input.cameras} {params.options} --threads {threads}"
        " --out {output.cameras} --record-failure {output}/ > {log} 2>&1"
