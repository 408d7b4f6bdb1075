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
        self._newest: list[Temperature] = []

    def publish_due(self, tick: int) -> None:
        """Publish the temperatures of this tick if they are due, to those who listen."""
        if tick % self._ticks == 0 and self._plant.temperatures.elements:
            self._newest = [self._message(i, tick * self._period_ns) for i in self._plant.temperatures.elements]
            self.repeat()

    def repeat(self) -> None:
        """Publish the newest again."""
        if self._newest and self.publisher.get_subscription_count():
            for message in self._newest:
                self.publisher.publish(message)

    def _message(self, element: int, stamp: int) -> Temperature:
        message = Temperature(temperature=float(self._plant.temperatures.now[element]))  # variance 0: exact
        message.header.frame_id = self._plant.friction_names[element]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        return message
