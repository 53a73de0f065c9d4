"""Poses that move, for Blender 3.6 and later. Open this file in its Text Editor and press Run Script, or

    blender --python THIS_FILE
    blender --background --python THIS_FILE -- scene.blend

Each body gets a collection: an empty for each joint, which has the keyframes, and an armature whose bones follow them.
To bake them into bones: select the armature, Pose > Animation > Bake Action with Visual Keying.
"""

import base64
import json
import os
import sys

import bpy  # type: ignore
import numpy as np

DATA = json.loads("@data@")


def curves_of(thing):
    """Return the curves of a thing's keyframes; Blender keeps them elsewhere from 4.4 on."""
    action = thing.animation_data.action
    if getattr(action, "layers", None):
        return action.layers[0].strips[0].channelbag(thing.animation_data.action_slot).fcurves
    return action.fcurves


def move(thing, times, places):
    """Give an object keyframes: places (times 3), straight lines between them."""
    thing.location = places[0]
    thing.keyframe_insert("location", frame=times[0])
    for curve in curves_of(thing):
        points = curve.keyframe_points
        points.add(len(times) - 1)
        points.foreach_set("co", np.column_stack([times, places[:, curve.array_index]]).ravel())
        points.foreach_set("interpolation", np.ones(len(times), np.int32))
        curve.update()


def joints_of(name, places, collection, top):
    """Make an empty for each joint that is known in some frame; return them by joint."""
    found, mark = {}, f"{name}:" if len(DATA["bodies"]) > 1 else ""
    for joint, label in enumerate(DATA["joints"]):
        known = np.flatnonzero(np.isfinite(places[:, joint]).all(1))
        if not len(known):
            continue
        empty = bpy.data.objects.new(mark + label, None)
        empty.empty_display_type, empty.empty_display_size = "SPHERE", 0.015 * DATA["size"]
        empty.parent = top
        collection.objects.link(empty)
        move(empty, (known + DATA["start"]).astype(float), places[known, joint])
        found[joint] = empty
    return found


def bones_of(name, places, collection, top, joints):
    """Make an armature with a bone from joint to joint, as long as its median, that follows the empties."""
    armature = bpy.data.armatures.new(name)
    rig = bpy.data.objects.new(f"{name} bones", armature)
    rig.parent = top
    collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    made, ends = {}, {}
    for start, end in DATA["bones"]:
        step = places[:, end] - places[:, start]
        length = np.linalg.norm(step, axis=1)
        known = np.flatnonzero(np.isfinite(length) & (length > 0))
        if not len(known):
            continue
        bone = armature.edit_bones.new(f"{DATA['joints'][start]}-{DATA['joints'][end]}")
        bone.head = places[known[0], start]
        bone.tail = places[known[0], start] + step[known[0]] * np.median(length[known]) / length[known[0]]
        bone.parent, bone.inherit_scale = ends.get(start), "NONE"
        ends[end] = bone
        made[bone.name] = (joints[start], joints[end])
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone, (start, end) in made.items():
        follow = rig.pose.bones[bone].constraints.new("COPY_LOCATION")
        follow.target = start
        point = rig.pose.bones[bone].constraints.new("STRETCH_TO")
        point.target, point.rest_length, point.volume = end, armature.bones[bone].length, "NO_VOLUME"


def main():
    scene = bpy.context.scene
    scene.render.fps = max(1, round(DATA["fps"]))
    scene.render.fps_base = scene.render.fps / DATA["fps"]
    scene.frame_start, scene.frame_end = DATA["start"], DATA["start"] + DATA["frames"] - 1
    if bpy.context.object is not None and bpy.context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for body in DATA["bodies"]:
        places = np.frombuffer(base64.b64decode(body["places"]), "<f4").reshape(DATA["frames"], -1, 3)
        collection = bpy.data.collections.new(body["name"])
        scene.collection.children.link(collection)
        top = bpy.data.objects.new(body["name"], None)
        collection.objects.link(top)
        joints = joints_of(body["name"], places, collection, top)
        bones_of(body["name"], places, collection, top, joints)
    scene.frame_set(DATA["start"])
    if "--" in sys.argv:
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(sys.argv[sys.argv.index("--") + 1]))


main()
