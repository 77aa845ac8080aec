/** The element of page.html with this id. */
export const element = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
