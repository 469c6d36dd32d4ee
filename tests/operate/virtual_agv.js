// A virtual AGV of vda-5050-lib: node virtual_agv.js PORT NAME X Y THETA
// It prints where it is at each of its ticks, [t, x, y, theta]: the states that it tells are stamped
// when they are sent, up to a tick after it was there.
const { AgvController, VirtualAgvAdapter } = require("vda-5050-lib");
const [port, name, x, y, theta] = process.argv.slice(2);
const options = {
  interfaceName: "uagv", vdaVersion: "2.0.0",
  transport: { brokerUrl: `mqtt://127.0.0.1:${port}` },
};
const initialPosition = { mapId: "map", x: +x, y: +y, theta: +theta, lastNodeId: "0" };
class Witnessed extends VirtualAgvAdapter {
  _onTick(...args) {
    super._onTick(...args);
    const { x, y, theta } = this.vehicleState.position;
    console.log(JSON.stringify([Date.now() / 1000, x, y, theta]));
  }
}
const agv = new AgvController(
  { manufacturer: "up_samp", serialNumber: name }, options,
  { agvAdapterType: Witnessed, publishStateInterval: 400, publishVisualizationInterval: 0 },
  { initialPosition, vehicleSpeed: 1.4, agvNormalDeviationThetaTolerance: 7 },
);
agv.start().catch(error => { console.error(error); process.exit(1); });
