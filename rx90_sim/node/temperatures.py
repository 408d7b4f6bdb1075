"""How warm joints and windings are, as messages: one for each friction element, and each motor, that gets warm."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Temperature

from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.qos import STATE_QOS
from rx90_common.exchange.qos_overrides import publish
from rx90_common.exchange.topics import MOTOR_NAMES, TEMPERATURES
from rx90_sim.plant import Plant


class Temperatures:
    """The topic `temperatures`; called by the ticking thread.

    Attributes:
        publisher: of the topic, which is there even if nothing gets warm.
    """

    def __init__(self, node: Node, plant: Plant, rates: Rates) -> None:
        self._period_ns, self._ticks = rates.period_ns, rates.temperature_ticks
        self.publisher: Publisher = publish(node, Temperature, TEMPERATURES, STATE_QOS.profile)
        warm = plant.temperatures
        self._values = [(plant.friction_names[i], warm.now, i) for i in warm.elements]
        if plant.constants["winding"]["used"][0]:
            self._values += [(name, plant.state["temperature"][0], i) for i, name in enumerate(MOTOR_NAMES)]
        self._tick = self._sent = -1

    def publish_due(self, tick: int) -> None:
        """Publish the temperatures of this tick if they are due, once, to those who listen.

        They are not repeated while time stands still: a recorder could not tell them from others of the same stamp.
        """
        if tick < self._tick:  # after a reset
            self._sent = -1
        self._tick = tick
        if tick % self._ticks or tick == self._sent or not self.publisher.get_subscription_count():
            return
        self._sent = tick
        stamp = tick * self._period_ns
        for name, temperatures, i in self._values:
            message = Temperature(temperature=float(temperatures[i]))  # variance 0: exact
            message.header.frame_id = name
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
            self.publisher.publish(message)
