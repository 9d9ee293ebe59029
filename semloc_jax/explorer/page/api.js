// Requests to the server; numbers come as a JSON head followed by raw little-endian arrays.

const TYPES = { float32: Float32Array, uint8: Uint8Array };

export async function getJson(path) {
  return (await checked(await fetch(path))).json();
}

export async function postJson(path, content) {
  return (await post(path, content)).json();
}

export async function evaluate(query) {
  return unpacked(await (await post("api/evaluate", query)).arrayBuffer());
}

async function post(path, content) {
  const body = JSON.stringify(content);
  return checked(await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body }));
}

async function checked(response) {
  if (response.ok) return response;
  const told = await response.json().catch(() => ({}));
  throw new Error(told.error || `the server answered ${response.status}`);
}

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, { dtype, shape, offset }] of Object.entries(head.arrays)) {
    const size = shape.reduce((a, b) => a * b, 1);
    arrays[name] = { data: new TYPES[dtype](buffer, 4 + length + offset, size), shape };
  }
  return { head, arrays };
}
