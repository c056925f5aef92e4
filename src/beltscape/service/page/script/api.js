// Requests to the server; changes carry the token that proves that they come from this page.
export class RequestError extends Error {
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

export async function get(path, query = {}) {
  const answer = await fetch(`${path}?${new URLSearchParams(query)}`, { headers: { accept: "application/json" } });
  if (!answer.ok) throw new RequestError(answer.status, await answer.text());
  return answer.json();
}

export async function post(path, body) {
  const { token } = await get("api/access/state");
  const headers = { "content-type": "application/json", ...(token ? { "x-beltscape-token": token } : {}) };
  const answer = await fetch(path, { method: "POST", headers, body: body === undefined ? undefined : JSON.stringify(body) });
  if (!answer.ok) throw new RequestError(answer.status, await answer.text());
  return answer.json();
}
