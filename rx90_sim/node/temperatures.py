"""How warm the joints are, as messages: one for each friction element that has a temperature."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Temperature

from rx90_common.base.rates import NANOSECONDS, ticks_per
from rx90_common.exchange.qos import STATE_QOS
from rx90_common.exchange.qos_overrides import publish
from rx90_common.exchange.topics import TEMPERATURES
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import Plant


class Temperatures:
    """The topic `temperatures`; called by the ticking thread.

    Attributes:
        publisher: of the topic, which is there even if no element has a temperature.

    Raises:
        ConfigError: if the rate does not divide the base rate.
    """

    def __init__(self, node: Node, plant: Plant, parameters: SimulationParameters) -> None:
        rates = parameters.rates
        self._plant, self._period_ns = plant, rates.period_ns
        self._ticks = ticks_per("temperature_rate", rates.base_hz, parameters.temperature_rate)
        self.publisher: Publisher = publish(node, Temperature, TEMPERATURES, STATE_QOS.profile)
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
        for element in self._plant.temperatures.elements:
            self.publisher.publish(self._message(element, tick * self._period_ns))

    def _message(self, element: int, stamp: int) -> Temperature:
        message = Temperature(temperature=float(self._plant.temperatures.now[element]))  # variance 0: exact
        message.header.frame_id = self._plant.friction_names[element]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        return message
