// Questions to the server, and wishes with the token that proves they come from this page.
export class Refused extends Error {
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

export async function get(path, query = {}) {
  const answer = await fetch(`${path}?${new URLSearchParams(query)}`, { headers: { accept: "application/json" } });
  if (!answer.ok) throw new Refused(answer.status, await answer.text());
  return answer.json();
}

export async function post(path, body) {
  const { token } = await get("/api/access/state");
  const headers = { "content-type": "application/json", ...(token ? { "x-beltscape-token": token } : {}) };
  const answer = await fetch(path, { method: "POST", headers, body: body === undefined ? undefined : JSON.stringify(body) });
  if (!answer.ok) throw new Refused(answer.status, await answer.text());
  return answer.json();
}
