"""Rig files as other programs' documentation shows them."""

from __future__ import annotations

OPENCV = """%YAML:1.0
---
calibration_time: "Tue Mar  4 10:11:12 2025"
nframes: 13
image_width: 640
image_height: 480
board_width: 9
board_height: 6
square_size: 2.5000000000000000e+01
flags: 0
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3591573396163199e+02, 0., 3.4228315473308373e+02, 0.,
       5.3591573396163199e+02, 2.3557082909788173e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.6637260909660682e-01, -3.8588898922304653e-02,
       1.7831947042852964e-03, -2.8122100441115472e-04,
       2.3839153080878486e-01 ]
avg_reprojection_error: 3.9259109564815858e-01
"""
"""OpenCV 4's calibration sample."""
OLD_OPENCV = """%YAML:1.0
image_Width: 640
image_Height: 480
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: f
   data: [ 650., 0., 319.5, 0., 651., 239.5, 0., 0., 1. ]
Distortion_Coefficients: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ -4.1e-01, 5.2e-01, 0., 1e-3 ]
"""
"""OpenCV 2's calibration sample: no ``---``, capital letters, four coefficients."""
KALIBR = """cam0:
  T_cam_imu:
  - [0.01779318, 0.99967549,-0.01822936, 0.07008565]
  - [-0.9998017, 0.01795239, 0.00860714,-0.01771023]
  - [0.00893160, 0.01807260, 0.99979678, 0.00399246]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /stereo/left/image_mono
  timeshift_cam_imu: -8.121e-05
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 0.0, -1.0, 0.02]
  - [0.0, 1.0, 0.0, 0.003]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 1e-3, 0]
  distortion_model: radtan
  intrinsics: [458, 459.5, 379.9, 238.4]
  resolution: [752, 480]
  rostopic: /stereo/right/image_mono
cam2:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.1]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [458.0, 459.5, 379.9, 238.4]
  resolution: [752, 480]
  rostopic: /stereo/third/image_mono
"""
COLMAP = """[
  {
    "cameras": [
      {
        "image_prefix": "rig1/camera1/",
        "ref_sensor": true,
        "camera_model_name": "SIMPLE_RADIAL",
        "camera_params": [1000.0, 320.0, 240.0, -0.05],
        "width": 640, "height": 480
      },
      {
        "image_prefix": "rig1/camera2/",
        "cam_from_rig_rotation": [0.7071067811865475, 0.0, 0.7071067811865476, 0.0],
        "cam_from_rig_translation": [0.25, 0, 0],
        "camera_model_name": "FULL_OPENCV",
        "camera_params": [900, 901, 320.5, 240.5, -0.1, 0.02, 1e-3, 2e-3, 0.01, 0, 0, 0],
        "width": 640, "height": 480
      }
    ]
  }
]
"""
ROS_LEFT = """image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [430.1, 0, 306.9, 0, 430.5, 227.2, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.3375, 0.1115, -0.0010, -5.3e-05, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999, 0.009, -0.02, -0.009, 0.999, 0.001, 0.02, -0.001, 0.999]
projection_matrix:
  rows: 3
  cols: 4
  data: [395.6, 0, 331.5, 0, 0, 395.6, 241.5, 0, 0, 0, 1, 0]
"""
"""camera_calibration_parsers, a rectified pair; yaml-cpp writes 5.3e-05 and whole numbers without a point."""
TF = """transforms:
- header:
    seq: 0
    stamp: {secs: 0, nsecs: 0}
    frame_id: base_link
  child_frame_id: narrow_stereo/left
  transform:
    translation: {x: 0.0, y: 0.0, z: 2.0}
    rotation: {x: 1.0, y: 0.0, z: 0.0, w: 0.0}
- header:
    frame_id: narrow_stereo/left
  child_frame_id: right
  transform:
    translation: {x: 0.1, y: 0.0, z: 0.0}
    rotation: {x: 0.0, y: 0.0, z: 0.7071068, w: 0.7071068}
"""
