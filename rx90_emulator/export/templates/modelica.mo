package {{ name | word }}_friction "Friction for Rotational.Components.BearingFriction, joint side, rad/s and Nm"
{# The first row is the break-away torque, so peak is 1. #}
{% for fit in fits %}
  constant Real {{ (fit.name ~ "_tau_pos") | modelica }}[:, 2] = [
{% for speed, torque in fit.law.table %}
    {{ speed | numbers }}, {{ torque | numbers }}{{ "];" if loop.last else ";" }}
{% endfor %}
  constant Real {{ (fit.name ~ "_peak") | modelica }} = 1.0;
{% endfor %}
end {{ name | word }}_friction;
