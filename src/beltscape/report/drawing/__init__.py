"""Building blocks of reports: charts, pictures, colours and 3-D scenes.

`plots` are Matplotlib's, `charts` put them on a page. `depth_picture` draws a depth map, `legend` has the
scales of colours, `palette` the colours by role, `pictures` the titled pictures, `scene` the 3-D scenes;
`markup` turns all of them into HTML.
"""
