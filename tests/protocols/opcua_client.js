// Reads, browses, subscribes and calls by node-opcua; prints what it found as one line of JSON.
// node opcua_client.js ADDRESS FOLDER_OF_CERTIFICATES USER PASSWORD

const {
  AttributeIds, ClientSubscription, DataType, MessageSecurityMode, OPCUAClient, SecurityPolicy, TimestampsToReturn,
  UserTokenType, makeBrowsePath,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const { constructEventFilter } = require("node-opcua-service-filter");

const [, , url, folder, userName, password] = process.argv;
const BELT = "ns=2;s=Belt";
const RATE = "/Objects/4:Machines/2:Belt/4:Components/7:BeltScale/4:Monitoring/4:Process/7:MassFlowRate.EngineeringUnits";

const count = (value) => (Array.isArray(value) ? value[0] * 2 ** 32 + value[1] : Number(value));

function makeClient(clientCertificateManager, mode) {
  return OPCUAClient.create({
    applicationName: "NodeTest", clientCertificateManager, securityMode: MessageSecurityMode[mode],
    securityPolicy: SecurityPolicy.Basic256Sha256, endpointMustExist: false, connectionStrategy: { maxRetry: 0 },
  });
}

async function read(session, path) {
  const value = await session.read({ nodeId: `${BELT}.${path}`, attributeId: AttributeIds.Value });
  return [value.statusCode.name, value.value.value];
}

async function readUnit(session) {
  const found = await session.translateBrowsePath(makeBrowsePath("RootFolder", RATE));
  const unit = await session.read({ nodeId: found.targets[0].targetId, attributeId: AttributeIds.Value });
  return [unit.value.value.displayName.text, unit.value.value.unitId];
}

async function readHistory(session) {
  const id = `${BELT}.Records.Number`;
  const found = await session.readHistoryValue(id, new Date(0), new Date("2100-01-01"), { numValuesPerNode: 1000 });
  return found.historyData.dataValues.map((one) => count(one.value.value));
}

async function call(session, method, texts) {
  const inputArguments = texts.map((value) => ({ dataType: DataType.String, value }));
  const methodId = `${BELT}.Commands.${method}`;
  return (await session.call({ objectId: `${BELT}.Commands`, methodId, inputArguments })).statusCode.name;
}

async function subscribe(session, mode) {
  const seen = [], events = [];
  const subscription = ClientSubscription.create(session, {
    requestedPublishingInterval: 100, requestedLifetimeCount: 100, requestedMaxKeepAliveCount: 10, publishingEnabled: true,
  });
  const queue = { samplingInterval: 0, discardOldest: true, queueSize: 100 };
  const number = { nodeId: `${BELT}.Records.Number`, attributeId: AttributeIds.Value };
  (await subscription.monitor(number, queue, TimestampsToReturn.Both))
    .on("changed", (one) => seen.push(count(one.value.value)));
  const fields = ["Message", "Severity", "ConditionName", "ActiveState.Id", "AckedState.Id", "EventId"];
  const server = { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier };
  const filter = constructEventFilter(fields);
  (await subscription.monitor(server, { ...queue, filter }, TimestampsToReturn.Both)).on("changed", (one) =>
    events.push(one.map((field) => field.value?.text ?? (Buffer.isBuffer(field.value) ? field.value.length : field.value))));
  await new Promise((done) => setTimeout(done, 300));
  console.log(`READY ${mode}`);
  for (let turn = 0; turn < 100 && (events.length === 0 || seen.length < 31); turn++) {
    await new Promise((done) => setTimeout(done, 50));
  }
  await subscription.terminate();
  return { seen, events };
}

async function main() {
  const certificates = new OPCUACertificateManager({ rootFolder: folder, automaticallyAcceptUnknownCertificate: true });
  await certificates.initialize();
  const user = { type: UserTokenType.UserName, userName, password }, out = { refused: [] };
  for (const mode of ["Sign", "SignAndEncrypt"]) {
    const client = makeClient(certificates, mode);
    await client.connect(url);
    const session = await client.createSession(user);
    out[mode] = {
      flow: await read(session, "Monitoring.Process.VolumeFlowRate"),
      speed: await read(session, "Monitoring.Process.BeltSpeed"),
      unit: await readUnit(session),
      total: (await read(session, "Components.Scale.MasterTotalizer.TotalizedValue"))[1],
      history: await readHistory(session),
      calls: [await call(session, "StartBatch", ["truck", ""]), await call(session, "StopBatch", [])],
      ...(await subscribe(session, mode)),
    };
    await session.close();
    await client.disconnect();
  }
  const client = makeClient(certificates, "SignAndEncrypt");
  await client.connect(url);
  const attempts = { "wrong password": { ...user, password: "wrong" }, anonymous: { type: UserTokenType.Anonymous } };
  for (const [name, attempt] of Object.entries(attempts)) {
    await client.createSession(attempt).catch(() => out.refused.push(name));
  }
  await client.disconnect();
  console.log(`RESULT ${JSON.stringify(out)}`);
}

main().then(() => process.exit(0), (error) => { console.log(error.stack); process.exit(1); });
