#!/usr/bin/env python3
"""Sends the simulated arm's goal to the planner by its action, and waits until the arm is there.

    wm sim_arm  --ros-args -p goal_period:=0.4 -r goal:=task_goal -r goal/image:=task_goal/image
    wm encoder & wm planner --ros-args --params-file launch-configs/config/arm.yaml
    wm executor --ros-args --params-file launch-configs/config/arm.yaml -p arm_on_start:=true
"""
import rclpy
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool
from wm_msgs.action import Plan
from wm_msgs.msg import Goal

rclpy.init()
node, goals, successes, costs = rclpy.create_node("goal_sender"), [], [], []
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Goal, "/wm/task_goal", goals.append, latched)
node.create_subscription(Bool, "/task/success", lambda success: successes.append(success.data), latched)
planner = ActionClient(node, Plan, "/wm/planner/plan")
planner.wait_for_server()
while not goals:
    rclpy.spin_once(node)
goal = Plan.Goal(goal=goals[0])
goal.duration.sec = 60
sent = planner.send_goal_async(goal, lambda news: costs.append(news.feedback.best_cost))
rclpy.spin_until_future_complete(node, sent)
while not any(successes):
    rclpy.spin_once(node)
rclpy.spin_until_future_complete(node, sent.result().cancel_goal_async())
print(f"the arm is there: costs from {costs[0]:.3f} to {costs[-1]:.3f}")
