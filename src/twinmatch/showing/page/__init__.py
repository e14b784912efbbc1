"""The live page: the state of the running graph, in a browser on this machine.

One node subscribes to the graph and fills a `DashboardState`, which is bounded and depends on neither ROS nor
Bokeh. A Bokeh server shows it in every open tab; each tab draws what is new since its last update.
"""
